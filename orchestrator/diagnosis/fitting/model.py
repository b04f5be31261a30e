"""What a fit consists of: the space of maps, the model, what is kept between steps, and the result. Fits nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.corrections import apply_effects
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import true_frame
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.noise import SensorNoise, Whitener
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import SignalBatch

ColumnName = tuple[str, str]
"""Effect and parameter that a column belongs to."""


@dataclass(frozen=True)
class MapSpace:
    """The family of maps in which the fit may look: coefficients = origin + directions @ free.

    Attributes
    ----------
    grid : EvenSpline
    origin : array, shape (coefficients,)
    directions : array, shape (coefficients, free)
    prior : array, shape (rows, free)
        Rows of a unit-variance prior on the free numbers.
    roughness : float
        How much rougher than usual the map may be by that prior.
    """

    grid: EvenSpline
    origin: Array
    directions: Array
    prior: Array
    roughness: float = 1.0

    @cached_property
    def is_free(self) -> bool:
        """Whether every coefficient is free by itself."""
        rows, columns = self.directions.shape
        return rows == columns and bool(np.array_equal(self.directions, np.eye(rows)))


@dataclass(frozen=True)
class Model:
    """The model as it stands."""

    space: MapSpace
    magnetics: Magnetics
    r_s: float
    active: tuple[EffectTerm, ...] = ()

    def with_active(self, active: Sequence[EffectTerm]) -> Model:
        return replace(self, active=tuple(active))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(a.name for a in self.active)

    @property
    def free(self) -> list[tuple[EffectTerm, str]]:
        """Every free parameter of the active effects, in order."""
        return [(a, n) for a in self.active for n in a.free]


@dataclass(frozen=True)
class SegmentLinearisation:
    """What is kept of one piece between steps, beside its signals."""

    whitener: Whitener
    basis: Array
    white_basis: Array
    """Whitened, on the map's free directions."""
    mean_inductance: Array
    """Of the map that the noise was carried through, shape (3,)."""
    noise_parameters: dict[ColumnName, float]
    """Coordinates of those effects that the noise was carried through: the inverter's, and those with doubts."""


@dataclass(frozen=True)
class BatchLinearisation:
    """What is kept of a batch of segments between steps."""

    batch: SegmentBatch
    base: SignalBatch
    """As measured, with the model's resistance and flux."""
    pieces: tuple[SegmentLinearisation, ...]
    """In the batch's order."""


@dataclass(frozen=True)
class Linearisation:
    """What is kept of a recording between steps."""

    space: MapSpace
    noise: SensorNoise
    batches: tuple[BatchLinearisation, ...]
    gram: Array
    """white_basis^T white_basis over the training pieces."""

    @cached_property
    def pieces(self) -> tuple[SegmentLinearisation, ...]:
        """In the recording's order."""
        ordered = {k: one for b in self.batches for k, one in zip(b.batch.places, b.pieces, strict=True)}
        return tuple(ordered[k] for k in sorted(ordered))

    def base_of(self, index: int) -> tuple[SegmentBatch, SignalBatch]:
        """One piece as a batch of its own, and its signals as measured, with the model's resistance and flux."""
        for frame in self.batches:
            if index in frame.batch.places:
                j = frame.batch.places.index(index)
                return frame.batch.singles[j], SignalBatch.of([frame.base.segment(j)])
        raise IndexError(index)


@dataclass(frozen=True)
class SegmentRows:
    """One piece's equations where the model stands: y = known + r_s * resistance + basis @ (c - c_model)."""

    known: Array
    resistance: Array
    white: Array
    """Whitened [known, resistance, columns...]."""

    @property
    def columns(self) -> Array:
        return self.white[:, 2:]


@dataclass(frozen=True)
class Answers:
    """Which inner effects respond to which columns, as measured on a few segments.

    Attributes
    ----------
    of : dict
        By column.
    sizes : dict
        Relative size of every effect that was present then.
    """

    of: Mapping[ColumnName, frozenset[str]] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Fit:
    """A model fitted, and how well."""

    model: Model
    frame: Linearisation
    prepared: PreparedRecording
    chi2: float
    """Sum of squares of the whitened training residual."""
    objective: float
    """chi2 + log det of the noise covariance + prior terms."""
    log_det: float
    dof: float
    residual: tuple[Array, ...]
    """Whitened residual of every piece."""
    volts: tuple[Array, ...]
    """Residual of every piece in volts: y_m / (sum_k |w_mk| Ts)."""
    normal: Array
    """Normal matrix of (R_s, map) with its prior."""
    columns: tuple[Array, ...]
    """Whitened columns of every piece: the free parameters', then the requested extra ones.

    None of a piece that is held out."""
    parameters: tuple[ColumnName, ...]
    """What the columns belong to."""
    resistance: tuple[Array, ...]
    """Whitened R_s columns."""
    answers: Answers = field(default_factory=Answers)
    """Which effects the columns pass through."""

    @property
    def criteria(self) -> Criteria:
        return self.prepared.criteria

    @property
    def chi2_per_dof(self) -> float:
        return self.chi2 / self.dof

    def corrected(self, index: int) -> SignalBatch:
        """One piece's signals as the model's effects say that they truly are, as a batch of one."""
        return apply_effects(self.frame.base_of(index)[1], self.model.active).signals

    def true_currents(self) -> list[Array]:
        """Every piece's magnetising current (n, 2) in the true rotor frame."""
        seen: dict[int, Array] = {}
        for frame in self.frame.batches:
            i_dq, _ = true_frame(frame.batch, apply_effects(frame.base, self.model.active).signals)
            seen |= {k: i_dq[frame.base.slice_of(j)] for j, k in enumerate(frame.batch.places)}
        return [seen[k] for k in sorted(seen)]

    def chi2_of(self, use: Callable[[SegmentData], bool]) -> float | None:
        """Mean square of the whitened residual of some pieces; None where there are none."""
        parts = [e for p, e in zip(self.prepared.pieces, self.residual, strict=True) if use(p)]
        return float(np.mean(np.concatenate(parts) ** 2)) if parts else None

    def rms_v(self, use: Callable[[SegmentData], bool]) -> float | None:
        """rms of some pieces' residual in volts; None where there are none."""
        parts = [e for p, e in zip(self.prepared.pieces, self.volts, strict=True) if use(p)]
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None

    def projected(self) -> tuple[Array, Array]:
        """Normal matrix and gradient of all columns after R_s and the map have followed them; not to be changed."""
        return self._projected

    @cached_property
    def _projected(self) -> tuple[Array, Array]:
        width = self.normal.shape[0]
        count = len(self.parameters)
        cross, columns_normal, gradient = np.zeros((width, count)), np.zeros((count, count)), np.zeros(count)
        for p, f, d, r, e in zip(
            self.prepared.pieces, self.frame.pieces, self.columns, self.resistance, self.residual, strict=True
        ):
            if p.held_out:
                continue
            cross[0] += r @ d
            cross[1:] += f.white_basis.T @ d
            columns_normal += d.T @ d
            gradient += d.T @ e
        return columns_normal - cross.T @ np.linalg.solve(self.normal, cross), gradient

    def system(self) -> tuple[Array, Array]:
        """Normal matrix of R_s, the map and all columns with their priors, and each training segment's gradient."""
        width, count = self.normal.shape[0], len(self.parameters)
        total = np.eye(width + count)
        total[:width, :width] = self.normal
        pulls = []
        for linear, d, e in self.training():
            total[:width, width:] += linear.T @ d
            total[width:, width:] += d.T @ d
            pulls.append(np.concatenate([linear.T @ e, d.T @ e]))
        total[width:, :width] = total[:width, width:].T
        return total, np.array(pulls)

    def training(self) -> Iterator[tuple[Array, Array, Array]]:
        """Of each training segment the whitened columns of R_s and the map, all others', and the residual."""
        for p, f, d, r, e in zip(
            self.prepared.pieces, self.frame.pieces, self.columns, self.resistance, self.residual, strict=True
        ):
            if not p.held_out:
                yield np.column_stack([r, f.white_basis]), d, e

    def covariance(self, noise: float = 1.0) -> Array:
        """Posterior covariance of the free coordinates, in the order of `model.free`; noise this much more than known.

        Parameters
        ----------
        noise : float
            In chi2 per degree of freedom.
        """
        count = len(self.model.free)
        normal, _ = self.projected()
        return np.asarray(np.linalg.inv(normal[:count, :count] / noise + np.eye(count)))
