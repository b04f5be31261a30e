"""Data types of a fit: the space of maps, the model, the cached linearisation and the result."""

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
from orchestrator.numerics.local_rows import triangular_factor
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import RealArray, SignalBatch, Signals

ColumnName = tuple[str, str]
"""Effect and parameter that a column belongs to."""


@dataclass(frozen=True)
class MapSpace:
    """Affine space of maps of a fit: coefficients = origin + directions @ free.

    Attributes
    ----------
    grid : EvenSpline
    origin : array, shape (coefficients,)
    directions : array, shape (coefficients, free)
    prior : array, shape (rows, free)
        Rows of a unit-variance prior on the free numbers.
    roughness : array, shape (m, n)
        Roughness that the prior allows, relative to the usual one, at m nodes along i_d by n from i_q = 0 outwards.
    """

    grid: EvenSpline
    origin: Array
    directions: Array
    prior: Array
    roughness: Array = field(default_factory=lambda: np.ones((1, 1)))

    @cached_property
    def is_free(self) -> bool:
        """Whether every coefficient is free."""
        rows, columns = self.directions.shape
        return rows == columns and bool(np.array_equal(self.directions, np.eye(rows)))

    @cached_property
    def log_det_prior(self) -> float:
        """log det of the prior's normal matrix, of a free map."""
        factor = triangular_factor(self.prior, self.grid.functions[1])
        return 2.0 * float(np.log(np.abs(np.diag(factor))).sum())


@dataclass(frozen=True)
class Model:
    """R_s, map and effects with their present values."""

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
class DerivativeColumns:
    """The part of a segment's basis by which voltages follow the map's inductance and curvature."""

    columns: Array
    known: Array
    """Rows of that part which the linearisation's voltages have already, shape (rows,)."""


@dataclass(frozen=True)
class SegmentLinearisation:
    """Quantities of one segment that are reused between steps."""

    whitener: Whitener
    basis: Array
    by_derivatives: DerivativeColumns | None
    """None where they are neglected."""
    white_basis: Array
    """Whitened basis projected on the map's free directions."""
    mean_inductance: Array
    """Mean L_dd, L_dq, L_qq for which the noise covariance was computed, shape (3,) [H]."""
    noise_parameters: dict[ColumnName, float]
    """Standardised values of the effects in the noise covariance: the inverter's, and those with random directions."""


@dataclass(frozen=True)
class BatchLinearisation:
    """Quantities of a batch of segments that are reused between steps.

    Attributes
    ----------
    batch : SegmentBatch
    r_s : float
        Resistance of the model [ohm].
    loss_ratio : float
        Copper losses of the model over those of the nameplate's resistance.
    segments : tuple of Signals
        What is the same throughout each segment, with the model's losses.
    changed : dict of str to array
        The model's flux for the effects, and voltages with carrier ripple.
    pieces : tuple of SegmentLinearisation
        In the batch's order.
    """

    batch: SegmentBatch
    r_s: float
    loss_ratio: float
    segments: tuple[Signals, ...]
    changed: Mapping[str, RealArray] = field(default_factory=dict)
    pieces: tuple[SegmentLinearisation, ...] = ()

    @classmethod
    def of(cls, batch: SegmentBatch, r_s: float) -> BatchLinearisation:
        """A batch with a model's resistance and its losses, without flux."""
        s = batch.signals
        # R_s may be negative during a descent, but a loss may not.
        ratio = max(r_s, 0.0) / ((s.motor.stator_resistance_ohm if s.motor else None) or 1.0)
        # Segments that share a loss history share the scaled one.
        histories = {id(one.losses): one.losses for one in s.segments}
        scaled = {k: h and replace(h, power_w=h.power_w * ratio) for k, h in histories.items()}
        return cls(batch, r_s, ratio, tuple(replace(one, losses=scaled[id(one.losses)]) for one in s.segments))

    @property
    def base(self) -> SignalBatch:
        """Measured signals with the model's resistance, losses and flux."""
        s = self.batch.signals
        made = {"resistance_ohm": np.full(s.samples, self.r_s), "heat_j": s.heat_j * self.loss_ratio}
        return s.replaced({**made, **self.changed}).with_segments(self.segments)

    def with_changed(self, arrays: Mapping[str, RealArray]) -> BatchLinearisation:
        """The linearisation with other arrays of the base."""
        return replace(self, changed={**self.changed, **arrays})


@dataclass(frozen=True)
class Linearisation:
    """Quantities of a recording that are reused between steps."""

    model: Model
    """The model at which it was made."""
    noise: SensorNoise
    batches: tuple[BatchLinearisation, ...]
    gram: Array
    """Sum of white_basis^T white_basis over the training segments."""

    @property
    def space(self) -> MapSpace:
        return self.model.space

    @cached_property
    def pieces(self) -> tuple[SegmentLinearisation, ...]:
        """In the recording's order."""
        ordered = {k: one for b in self.batches for k, one in zip(b.batch.places, b.pieces, strict=True)}
        return tuple(ordered[k] for k in sorted(ordered))

    def base_of(self, index: int) -> tuple[SegmentBatch, SignalBatch]:
        """One segment as a batch, and its measured signals with the model's resistance and flux."""
        for linearisation in self.batches:
            if index in linearisation.batch.places:
                j = linearisation.batch.places.index(index)
                return linearisation.batch.singles[j], SignalBatch.of([linearisation.base.segment(j)])
        raise IndexError(index)


@dataclass(frozen=True)
class SegmentRows:
    """One segment's equations at a model: y = known + r_s * resistance + basis @ (c - c_model)."""

    known: Array
    resistance: Array
    white: Array
    """Whitened [known, resistance, columns...]."""

    @property
    def columns(self) -> Array:
        return self.white[:, 2:]


@dataclass(frozen=True)
class Responses:
    """Responses of inner effects (further from the sensors) to the columns, as measured on a few segments.

    Attributes
    ----------
    of : dict
        Inner effects by column.
    sizes : dict
        Relative size of each effect when it was probed.
    """

    of: Mapping[ColumnName, frozenset[str]] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Fit:
    """A fitted model with its residual and normal equations."""

    model: Model
    linearisation: Linearisation
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
    """Whitened columns of every segment: the free parameters, then the extra ones; empty where held out."""
    parameters: tuple[ColumnName, ...]
    """Effect and parameter of each column."""
    resistance: tuple[Array, ...]
    """Whitened R_s columns."""
    responses: Responses = field(default_factory=Responses)
    """Inner effects that respond to the columns."""

    @property
    def criteria(self) -> Criteria:
        return self.prepared.criteria

    @property
    def chi2_per_dof(self) -> float:
        return self.chi2 / self.dof

    def corrected(self, index: int) -> SignalBatch:
        """One segment's signals corrected by the model's effects, as a batch of one."""
        return apply_effects(self.linearisation.base_of(index)[1], self.model.active).signals

    def true_currents(self) -> list[Array]:
        """Every piece's magnetising current (n, 2) in the true rotor frame."""
        seen: dict[int, Array] = {}
        for linearisation in self.linearisation.batches:
            batch = linearisation.batch
            i_dq, _ = true_frame(batch, apply_effects(linearisation.base, self.model.active).signals)
            seen |= {k: i_dq[batch.signals.slice_of(j)] for j, k in enumerate(batch.places)}
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
        """Normal matrix and gradient of all columns with R_s and the map eliminated; read-only."""
        return self._projected

    @cached_property
    def _projected(self) -> tuple[Array, Array]:
        width = self.normal.shape[0]
        count = len(self.parameters)
        cross, columns_normal, gradient = np.zeros((width, count)), np.zeros((count, count)), np.zeros(count)
        for p, f, d, r, e in zip(
            self.prepared.pieces, self.linearisation.pieces, self.columns, self.resistance, self.residual, strict=True
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
        """For each training segment: whitened columns of R_s and the map, the other columns, and the residual."""
        for p, f, d, r, e in zip(
            self.prepared.pieces, self.linearisation.pieces, self.columns, self.resistance, self.residual, strict=True
        ):
            if not p.held_out:
                yield np.column_stack([r, f.white_basis]), d, e

    def covariance(self, noise: float = 1.0) -> Array:
        """Posterior covariance of the standardised free parameters, in the order of `model.free`.

        Parameters
        ----------
        noise : float
            Variance of the residual relative to the known noise (chi2 per degree of freedom).
        """
        count = len(self.model.free)
        normal, _ = self.projected()
        return np.asarray(np.linalg.inv(normal[:count, :count] / noise + np.eye(count)))
