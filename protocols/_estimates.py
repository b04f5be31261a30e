"""Estimators: what they declare, and their typed results."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, ClassVar, Protocol, TypeVar, runtime_checkable

from protocols._base import ArrayModel, Lenient, RealArray, Shape, Strict, Vectors
from protocols._recording import RecordingReader
from protocols._remarks import Number, Remarks

Grid = Annotated[RealArray, Shape(("d", "q"))]
AxisD = Annotated[RealArray, Shape(("d",))]
AxisQ = Annotated[RealArray, Shape(("q",))]


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


class InverterLoss(Lenient):
    """Inverter voltage error per phase at currents well away from zero: dead time and device drops."""

    pwm_frequency_hz: float
    """0 where unknown."""
    phase_v: float
    std_v: float


class ResistanceEstimate(Lenient):
    """Stator resistance over a recording."""

    value_ohm: float
    low: float
    high: float
    """95 % interval of `value_ohm`."""
    first_ohm: float
    last_ohm: float
    readings: tuple[ResistanceReading, ...] = ()
    """Readings in order of time."""
    temperature_rise_k: Interval | None = None
    """Rise of a copper winding that started at 20 C, from the first reading to the last."""
    inverter: tuple[InverterLoss, ...] = ()
    """Inverter errors removed from the voltage, one for each PWM frequency; empty where not determined."""
    remarks: Remarks = ()

    @property
    def is_of_model(self) -> bool:
        """Whether this is the R_s of a diagnosed model, before any current warms the winding."""
        return any(remark.code == "model.of_the_model" for remark in self.remarks)


class Basis(StrEnum):
    """Kind of data behind a flux map."""

    INTEGRATION = "integration"
    """The voltage of swept currents, integrated over time; R_s and the inverter enter."""
    INJECTION = "injection"
    """Inductances by demodulated ripple, integrated over currents; R_s does not enter."""
    ENERGY = "energy"
    """One energy, fitted to either or both: parity and reciprocity hold by construction, so they check nothing."""


class FluxMap(ArrayModel):
    """Flux linkage and inductances on a rectangular grid of currents; NaN where not measured.

    psi(0, 0) = (pm_flux_wb, or 0 where unknown; 0).
    """

    method: str
    basis: Basis | None = None
    """None: other, or unknown."""
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


class IncrementalInductances(ArrayModel):
    """Inductances at a small ripple of one frequency and size, at the injected points."""

    frequency_hz: float
    amplitude_v: float
    """rms."""
    i_dq: Vectors
    """[A]."""
    inductance: Annotated[RealArray, Shape(("n", 3))]
    """(L_dd, L_dq, L_qq) [H], shape (n, 3)."""


class AxisPercent(Strict):
    """A check's figure on each axis, in per cent of the rated flux."""

    d_percent: Number
    q_percent: Number


class MapChecks(Strict):
    """Self-consistency checks; null where the recording does not allow them."""

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
    """A flux map with its origin and its consistency checks."""

    map: FluxMap
    points: FluxPoints
    checks: MapChecks
    form: ClosedForm | None = None
    """Parametric form of the map, where it has one."""
    incremental: tuple[IncrementalInductances, ...] = ()
    """Inductances of maps by injection: one entry for each frequency and size of the ripple, by frequency."""
    remarks: Remarks = ()


Estimate = ResistanceEstimate | FluxMapEstimate


Product = TypeVar("Product", bound=ResistanceEstimate | FluxMapEstimate)


@dataclass(frozen=True)
class EstimationContext:
    """Results of earlier estimators of the same pass, in order."""

    estimates: tuple[Estimate, ...] = ()

    def of(self, kind: type[Product]) -> list[Product]:
        """All estimates of one kind, sub-classes included."""
        return [estimate for estimate in self.estimates if isinstance(estimate, kind)]

    def latest(self, kind: type[Product]) -> Product | None:
        """The last one of a kind; None where there is none."""
        return next(reversed(self.of(kind)), None)

    @property
    def resistance(self) -> ResistanceEstimate | None:
        """The one with the narrowest interval."""
        return min(self.of(ResistanceEstimate), key=lambda estimate: estimate.high - estimate.low, default=None)


@runtime_checkable
class Estimator(Protocol):
    """A pure function of a recording; entry point group ``fluxbench.estimators``.

    The entry point names a class that is made without arguments.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    requires: ClassVar[tuple[type[Estimate], ...]]
    """Kinds of estimate that it builds on: whatever of the same pass produces one of them runs before it. A kind may
    be a sub-class of the maker's own, with more in it. Where none was made it does without, or says so."""
    produces: ClassVar[type[Estimate]]
    rank: ClassVar[int]
    """The map of the highest rank is recommended, of those that can be relied on: an energy's is 30, injection's 20,
    integration's 10; 0 claims nothing. Of resistances the one with the narrowest interval is taken."""

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        """Estimate from the recording.

        Raises `NotMeasuredError` where the recording lacks what this estimator needs.
        """
        ...
