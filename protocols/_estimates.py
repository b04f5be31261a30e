"""What estimators hand back: resistance, flux maps, and the checks that need no truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from protocols._base import ArrayModel, Shape, Strict, Vectors
from protocols._recording import RecordingReader
from protocols._remarks import Number, Remarks

Grid = Annotated[np.ndarray[Any, np.dtype[np.floating[Any]]], Shape(("d", "q"))]
AxisD = Annotated[np.ndarray[Any, np.dtype[np.floating[Any]]], Shape(("d",))]
AxisQ = Annotated[np.ndarray[Any, np.dtype[np.floating[Any]]], Shape(("q",))]


class Interval(Strict):
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


class ResistanceReading(Strict):
    """R_s over one stretch of time."""

    start_s: float
    value_ohm: float
    std_ohm: float


class ResistanceEstimate(Strict):
    """Stator resistance over a recording."""

    value_ohm: float
    low: float
    high: float
    """95 % interval of `value_ohm`."""
    first_ohm: float
    last_ohm: float
    readings: tuple[ResistanceReading, ...]
    """In order of time."""
    remarks: Remarks = ()


class FluxMap(ArrayModel):
    """Flux linkage and inductances on a rectangular grid of currents; NaN where not measured.

    psi(0, 0) = (pm_flux_wb, or 0 where unknown; 0).
    """

    method: str
    i_d: AxisD
    """[A], increasing, shape (d,)."""
    i_q: AxisQ
    psi_d: Grid
    """[Wb], shape (d, q)."""
    psi_q: Grid
    l_dd: Grid
    """[H]."""
    l_dq: Grid
    l_qq: Grid
    psi_d_std: Grid
    psi_q_std: Grid
    l_dd_std: Grid
    l_dq_std: Grid
    l_qq_std: Grid


class FluxPoints(ArrayModel):
    """Flux linkage at the points that were really reached, in order of time."""

    i_dq: Vectors
    psi_dq: Vectors
    segment: tuple[str, ...]
    """Id of the segment each point is from."""


class AxisPercent(Strict):
    """A check's figure on each axis, in per cent of the rated flux."""

    d_percent: Number
    q_percent: Number


class MapChecks(Strict):
    """Checks that need no truth; null where the recording does not allow them."""

    crossings: AxisPercent | None = None
    """Largest flux difference where current paths cross."""
    parity: AxisPercent | None = None
    """Largest oddness of psi_d, and evenness of psi_q, in i_q."""
    reciprocity_percent: float | None = None
    """rms of dpsi_d/di_q - dpsi_q/di_d against the mean inductance."""


class Coefficient(Strict):
    """One number of a formula."""

    name: str
    value: float
    std: float
    unit: str


class ClosedForm(Strict):
    """A map as a formula with fitted coefficients."""

    formula: str
    coefficients: tuple[Coefficient, ...]


class FluxMapEstimate(ArrayModel):
    """A flux map, where it comes from, and how far it agrees with itself."""

    map: FluxMap
    points: FluxPoints
    checks: MapChecks
    form: ClosedForm | None = None
    """Where the map is one of a few numbers' rather than a table."""
    remarks: Remarks = ()


Estimate = ResistanceEstimate | FluxMapEstimate


@dataclass(frozen=True)
class EstimationContext:
    """What earlier estimators of the same pass found out."""

    resistance: ResistanceEstimate | None = None
    maps: Mapping[str, FluxMapEstimate] = field(default_factory=dict)


@runtime_checkable
class Estimator(Protocol):
    """A pure function of a recording; entry point group ``fluxbench.estimators``.

    The entry point names a class that is made without arguments.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    produces: ClassVar[Literal["resistance", "flux_map"]]

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        """Estimate from what the recording holds.

        Raises `NotMeasuredError` where the recording lacks what this estimator needs.
        """
        ...
