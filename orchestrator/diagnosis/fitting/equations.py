"""A batch's equations where a model stands: what its effects make of the signals, the noise, and the columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.cascade import Cascade, Change, array_of, step_of
from orchestrator.diagnosis.fitting.columns import ColumnProbe
from orchestrator.diagnosis.fitting.corrections import apply_effects, has_random_directions
from orchestrator.diagnosis.fitting.model import (
    BatchLinearisation,
    ColumnName,
    Model,
    SegmentLinearisation,
    SegmentRows,
)
from orchestrator.diagnosis.nuisances.carrier_ripple import carrier_ripple_voltage
from orchestrator.diagnosis.nuisances.dwells import QuantiserScatter, dwells
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import (
    LocalMap,
    basis,
    change_of_rows,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.noise import SensorNoise, Slopes, Whitener, banded_covariance
from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import from_two_phases, inductance_to_ab, rotation
from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import Correction, EffectLayer, ModelNoise, SignalBatch, Signals

FLUX_ITERATIONS: int = 2
"""How often the flux that effects see is evaluated again at the rotor's angle and at the magnetising current. A twist
of 0.03 rad leaves so much less of the torque each time. Once, where an earlier evaluation is at hand."""
MAX_INDUCTANCE_CHANGE: float = 0.01
"""Relative change of the mean inductance up to which the noise's covariance is kept."""
MAX_INVERTER_CHANGE: float = 0.1
"""Change of an inverter effect's standardised value, relative to one or to itself, up to which the covariance is
kept."""

OBSERVER_TIME_CONSTANT_S: float = 0.005
"""Time constant that draws the integrated flux to the map's [s]: long beside a ripple's period, short beside its
drift."""


@dataclass(frozen=True)
class BatchState:
    """A batch of segments where a model stands."""

    frame: BatchLinearisation
    cascade: Cascade
    local: LocalMap

    @property
    def batch(self) -> SegmentBatch:
        return self.frame.batch


@dataclass
class WeakFormEquations:
    """Makes the equations of any batch of a recording; remembers the columns of those that no effect moves."""

    noise: SensorNoise
    pm_flux_wb: float
    criteria: Criteria
    ripples: bool = False
    """Whether the resistance takes its part of a carrier's ripple (`weak_form.carrier_ripple`)."""
    _raw_basis: dict[int, tuple[SegmentBatch, EvenSpline, list[Array]]] = field(default_factory=dict)

    def renewed(self, model: Model, batch: SegmentBatch, old: BatchLinearisation | None) -> BatchState:
        """A batch where the model stands, in a frame made anew as far as it changed since `old`.

        Its signals are led through the effects but once for both.
        """
        base = self._with_resistance(model, batch)
        # A sensor's lag and skin effect need the current without noise: the earlier one, else the one of this flux.
        if old is not None:
            base = base.replaced(_flux_of(old.base))
        elif model.active:
            base = base.replaced(self._flux(batch, base, model)[0])
        flux, seen = self._flux(batch, base, model)
        base = base.replaced(flux)
        cascade = Cascade.of(base, model.active)
        same = not cascade.changed & {"i_m_ab", "theta_rad"}
        local = seen if same else local_map(batch, cascade.corrected, model.magnetics)
        raw = self._untouched_basis(batch, local, model) if same else basis(batch, local, model.magnetics)
        state = BatchState(BatchLinearisation(batch, base, ()), cascade, local)
        noises = self._noises(state, model, old)
        pieces = []
        for j, (whitener, mean, noise_parameters) in enumerate(noises):
            before = None if old is None else old.pieces[j]
            if before is not None and whitener is before.whitener and raw[j] is before.basis:
                white = before.white_basis
            else:
                white = whitener(raw[j] if model.space.is_free else raw[j] @ model.space.directions)
            pieces.append(SegmentLinearisation(whitener, raw[j], white, mean, noise_parameters))
        return BatchState(BatchLinearisation(batch, base, tuple(pieces)), cascade, local)

    def at(self, model: Model, frame: BatchLinearisation) -> BatchState:
        """A batch where the model stands, in a frame of before."""
        cascade = Cascade.of(frame.base, model.active)
        return BatchState(frame, cascade, local_map(frame.batch, cascade.corrected, model.magnetics))

    def common(self, model: Model, frame: BatchLinearisation) -> list[Array]:
        """What each segment's readings may have in common, whitened: columns as of `_common_rows`."""
        state = self.at(model, frame)
        slopes = self._slopes(frame.batch, frame.base, model)
        return [kept.whitener(self._common_rows(state, j, slopes)) for j, kept in enumerate(frame.pieces)]

    def _with_resistance(self, model: Model, batch: SegmentBatch) -> SignalBatch:
        """The signals as measured, with the model's resistance, and the losses that it makes."""
        s = batch.signals
        # On its way to where it fits R_s may be below nothing; a loss is not.
        scale = max(model.r_s, 0.0) / ((s.motor.stator_resistance_ohm if s.motor else None) or 1.0)
        base = s.replaced({"resistance_ohm": np.full(s.samples, model.r_s), "heat_j": s.heat_j * scale}).with_segments(
            _with_losses(s.segments, scale)
        )
        if not self.ripples:
            return base
        taken = [
            carrier_ripple_voltage(piece, base.segment(j), model.magnetics) for j, piece in enumerate(batch.pieces)
        ]
        return base.replaced({"v_ab": base.v_ab + np.concatenate(taken)})

    def _noises(
        self, state: BatchState, model: Model, old: BatchLinearisation | None
    ) -> list[tuple[Whitener, Array, dict[ColumnName, float]]]:
        """Of each segment how its noise is whitened, and by what: as before, where that bears what has moved since."""
        batch, local, corrected = state.batch, state.local, state.cascade.corrected
        noise_parameters = self._noise_parameters(batch, model)
        means = np.add.reduceat(local.inductance, batch.layout.starts[:-1]) / np.diff(batch.layout.starts)[:, None]
        found: list[tuple[Whitener, Array, dict[ColumnName, float]] | None] = [None] * len(batch.pieces)
        if old is not None:
            same = self._same_noise(means, noise_parameters, old)
            found = [
                (kept.whitener, kept.mean_inductance, kept.noise_parameters) if as_before else None
                for kept, as_before in zip(old.pieces, same, strict=True)
            ]
        if all(one is not None for one in found):
            return [one for one in found if one is not None]
        slopes = self._slopes(batch, state.frame.base, model)
        doubts = self._doubted_rows(state)
        made = []
        for j, (piece, known) in enumerate(zip(batch.pieces, found, strict=True)):
            if known is not None:
                made.append(known)
                continue
            at = corrected.slice_of(j)
            own = local.part(at)
            turned = None if slopes is None else _in_frame_of(piece, slopes[at])
            factor = np.asarray(corrected.resistance_ohm[at] / model.r_s, dtype=np.float64)
            covariance = banded_covariance(piece, own, factor, self.noise, model.r_s, turned)
            common, scatter = [rows[batch.rows_of(j)] for rows in doubts], self.noise.of_model
            if scatter.scatters:
                rows = self._common_rows(state, j, slopes)
                common.append(rows * scatter_sizes(QuantiserScatter.of(piece), scatter))
            whitener = Whitener.of(covariance, np.column_stack(common) if common else None)
            made.append((whitener, means[j], noise_parameters))
        return made

    def _common_rows(self, state: BatchState, j: int, slopes: Array | None) -> Array:
        """What an ampere on all readings of phase a or b does to a segment's equations, and a volt on each axis.

        The volt is that of each rest, for a voltage that moves is dithered. The ampere acts through the voltage, too,
        by the inverter's slopes (n, 2, 2). Shape (rows, 2 + 2 rests).
        """
        at = state.cascade.corrected.slice_of(j)
        one, own = state.batch.singles[j], state.local.part(at)
        corrected = SignalBatch.of([state.cascade.corrected.segment(j)])
        n = corrected.samples
        changes: list[Change] = []
        for phases in (1.0, 0.0), (0.0, 1.0):
            off = np.empty((n, 2))
            off[:] = from_two_phases(*phases)
            change: Change = {"i_ab": off, "i_m_ab": off}
            if slopes is not None:
                change["v_ab"] = np.ascontiguousarray(slopes[at] @ from_two_phases(*phases))
            changes.append(change)
        for dwell in dwells(one.pieces[0]):
            for axis in np.eye(2):
                volt = np.zeros((n, 2))
                volt[dwell] = axis
                changes.append({"v_ab": volt})
        return np.stack([change_of_rows(one, corrected, c, own, self.pm_flux_wb) for c in changes], axis=-1)

    def _noise_parameters(self, batch: SegmentBatch, model: Model) -> dict[ColumnName, float]:
        """Coordinates of the effects that have a part in the noise: that multiply it, or do not know all they do."""
        on = batch.pieces[0].signals.bridge_on
        there = [a for a in model.active if on and (_multiplies_noise(a) or has_random_directions(a))]
        return {(a.name, p.name): a.standardised_value(p.name) for a in there for p in a.candidate.parameters}

    def _doubted_rows(self, state: BatchState) -> list[Array]:
        """What each doubt of an effect does to the equations, one standard deviation of it: each of shape (rows,)."""
        at, magnet = state.cascade.corrected, self.pm_flux_wb
        directions = state.cascade.random_directions()
        return [change_of_rows(state.batch, at, change, state.local, magnet) for change in directions]

    def _same_noise(
        self, inductances: Array, noise_parameters: dict[ColumnName, float], old: BatchLinearisation
    ) -> list[bool]:
        """Of each segment, whether its noise's covariance bears what has moved since an earlier frame."""
        is_same = dict[int, bool]()
        before = np.stack([kept.mean_inductance for kept in old.pieces])
        moved = np.abs(inductances - before).max(axis=1)
        bearable = MAX_INDUCTANCE_CHANGE * inductances[:, [0, 2]].min(axis=1)
        # Segments whose noise was computed at once share its parameters.
        for kept in old.pieces:
            if id(kept.noise_parameters) not in is_same:
                is_same[id(kept.noise_parameters)] = noise_parameters.keys() == kept.noise_parameters.keys() and all(
                    abs(x - kept.noise_parameters[k]) <= MAX_INVERTER_CHANGE * max(abs(x), 1.0)
                    for k, x in noise_parameters.items()
                )
        return [
            bool(steady) and is_same[id(kept.noise_parameters)]
            for kept, steady in zip(old.pieces, moved < bearable, strict=True)
        ]

    def _untouched_basis(self, batch: SegmentBatch, local: LocalMap, model: Model) -> list[Array]:
        known = self._raw_basis.get(id(batch))
        if known is None or known[1] != model.space.grid:
            known = (batch, model.space.grid, basis(batch, local, model.magnetics))
            self._raw_basis[id(batch)] = known
        return known[2]

    def _flux(self, batch: SegmentBatch, base: SignalBatch, model: Model) -> tuple[dict[str, Array], LocalMap]:
        """Flux linkage in the stator frame, magnet included, as the effects see it; and the map it was read from.

        Where the rotor does not lie as it is believed to, or not all of the current magnetises, the map is read again
        where it does, as far as that flux tells; or the one that `base` knows already, of much the same model.
        """
        outer = [a for a in model.active if a.candidate.effect.layer < EffectLayer.FRAME]
        moving = [a for a in model.active if a.candidate.effect.layer >= EffectLayer.FRAME and not a.is_absent]
        inner = apply_effects(base, outer).signals
        local = local_map(batch, inner, model.magnetics)
        if not moving:
            return self._flux_read(batch, inner, local), local
        known = base.psi_ab is not None
        found = _flux_of(base) if known else self._flux_read(batch, inner, local)
        for _ in range(1 if known else FLUX_ITERATIONS):
            moved = apply_effects(inner.replaced(found), moving)
            if not moved.changed & {"theta_rad", "i_m_ab"}:
                return self._flux_read(batch, inner, local), local
            there = moved.signals
            at = inner.replaced({"theta_rad": there.theta_rad})
            found = self._flux_read(batch, at, local_map(batch, there, model.magnetics))
        return found, local

    def _flux_read(self, batch: SegmentBatch, signals: SignalBatch, local: LocalMap) -> dict[str, Array]:
        """What effects see of the flux, by the signals' names."""
        layout = batch.layout
        if len(local.delta) > 0:
            theta = np.ascontiguousarray(signals.theta_rad, dtype=np.float64)
            turn = unit_vectors(theta)
        else:
            theta, turn = batch.believed_rad, np.column_stack([layout.cos, layout.sin])
        psi_ab, smooth, i_smooth = smooth_flux(
            local.psi,
            local.inductance,
            np.ascontiguousarray(signals.v_ab),
            np.ascontiguousarray(signals.i_ab),
            np.ascontiguousarray(signals.resistance_ohm),
            turn,
            self.pm_flux_wb,
            layout.starts,
            layout.interval_s,
            OBSERVER_TIME_CONSTANT_S,
        )
        inductance = inductance_to_ab(local.inductance, theta)
        return dict(zip(FLUX, (psi_ab, smooth, i_smooth, inductance), strict=True))

    def _slopes(self, batch: SegmentBatch, base: SignalBatch, model: Model) -> Array | None:
        """How the inverter's effects multiply current noise, by shifting the measured current by its noise.

        d v_impressed / d i_measured in the stator frame [ohm], shape (n, 2, 2); None where no effect does.
        """
        inverter = [a for a in model.active if _multiplies_noise(a)]
        if not (inverter and batch.pieces[0].signals.bridge_on):
            return None
        voltage = np.empty((base.samples, 2, 2))
        sensor = np.stack([np.sqrt(np.diag(self.noise.of(piece))) for piece in batch.pieces])
        lengths = np.diff(batch.layout.starts)
        for axis in range(2):
            shift = np.zeros((base.samples, 2))
            shift[:, axis] = np.repeat(sensor[:, axis], lengths)
            ahead, behind = (
                apply_effects(base.corrected(Correction(i_ab=base.i_ab + side * shift)), inverter).signals
                for side in (1.0, -1.0)
            )
            voltage[:, :, axis] = (ahead.v_ab - behind.v_ab) / (2.0 * shift[:, axis, None])
        return voltage

    def rows(
        self,
        at: BatchState,
        parameters: Sequence[tuple[EffectTerm, str]] = (),
        answering: Sequence[frozenset[str] | None] | None = None,
    ) -> list[SegmentRows]:
        """Each segment's equations where a model stands, and a column for each of some parameters.

        Parameters
        ----------
        answering : sequence of frozenset of str, optional
            Of every column the inner effects that answer to it; all by default.
        """
        inner_effects = answering if answering is not None else repeat(None)
        columns = _Columns.of(at.batch, len(parameters))
        for k, ((active, name), inner) in enumerate(zip(parameters, inner_effects, strict=False)):
            self._column(at, active, name, columns.of_parameter(k), inner)
        return self._white(at, columns)

    def probed(
        self, at: BatchState, parameters: Sequence[tuple[EffectTerm, str]], answering: Sequence[frozenset[str] | None]
    ) -> tuple[list[SegmentRows], list[ColumnProbe]]:
        """The same, and what each inner effect has to do with each column of which that is not known."""
        columns = _Columns.of(at.batch, len(parameters))
        keys, additions = [], []
        for k, ((active, name), inner) in enumerate(zip(parameters, answering, strict=True)):
            for effect, added in self._column(at, active, name, columns.of_parameter(k), inner).items():
                keys.append((k, effect))
                additions.append(added)
        rows = self._white(at, columns)
        together = np.stack(additions, axis=-1) if additions else np.zeros((int(at.batch.layout.rows[-1]), 0))
        probes = []
        for j, kept in enumerate(at.frame.pieces):
            power = np.sum(kept.whitener(together[at.batch.rows_of(j)]) ** 2, axis=0)
            answers = {key: float(p) for key, p in zip(keys, power, strict=True)}
            probes.append(ColumnProbe(rows[j].columns, answers))
        return rows, probes

    def _white(self, at: BatchState, columns: _Columns) -> list[SegmentRows]:
        """Each segment's equations where a model stands, with columns."""
        corrected, r_s = at.cascade.corrected, at.frame.base.resistance_ohm[0]
        in_parts = corrected.replaced({"resistance_ohm": corrected.resistance_ohm / r_s})
        voltage, resistance = voltage_and_resistance(at.batch, in_parts, at.local, self.pm_flux_wb)
        known = voltage + flux_terms(at.batch, at.local)
        columns.rows[:, 0], columns.rows[:, 1] = known, resistance
        made = []
        for j, kept in enumerate(at.frame.pieces):
            own = at.batch.rows_of(j)
            made.append(SegmentRows(known[own], resistance[own], kept.whitener(columns.rows[own])))
        return made

    def _column(
        self, at: BatchState, active: EffectTerm, name: str, out: Array, answering: frozenset[str] | None = None
    ) -> dict[str, Array]:
        """Derivative of y by one parameter's coordinate into `out` (rows,), and what inner effects had in it."""
        step = step_of(active, name)
        change, answers = at.cascade.change_by(active.moved(name, active.standardised_value(name) + step), answering)
        self._difference(at, change, step, out)
        corrected = at.cascade.corrected
        return {n: self._difference(at, c, step) for n, c in answers.items() if _beyond_rounding(c, corrected)}

    def _difference(self, at: BatchState, change: Change, step: float, out: Array | None = None) -> Array:
        rows = change_of_rows(at.batch, at.cascade.corrected, change, at.local, self.pm_flux_wb, out)
        rows /= step
        return rows


@dataclass(frozen=True)
class _Columns:
    """The equations of a batch before they are whitened, shape (rows, 2 + parameters), column by column in memory."""

    rows: Array

    @classmethod
    def of(cls, batch: SegmentBatch, parameters: int) -> _Columns:
        return cls(np.empty((int(batch.layout.rows[-1]), 2 + parameters), order="F"))

    def of_parameter(self, k: int) -> Array:
        return self.rows[:, 2 + k]


FLUX = ("psi_ab", "psi_smooth_ab", "i_smooth_ab", "inductance_ab")
"""What effects see of a model's flux, by the signals' names."""


def _with_losses(segments: Sequence[Signals], scale: float) -> tuple[Signals, ...]:
    """The same where losses are so many times as large; segments that share their history go on sharing it."""
    histories = {id(s.losses): s.losses for s in segments}
    scaled = {k: h and replace(h, power_w=h.power_w * scale) for k, h in histories.items()}
    return tuple(replace(s, losses=scaled[id(s.losses)]) for s in segments)


def _flux_of(signals: SignalBatch) -> dict[str, Array]:
    return {name: getattr(signals, name) for name in FLUX}


def _multiplies_noise(active: EffectTerm) -> bool:
    return active.candidate.effect.layer is EffectLayer.INVERTER and not active.is_absent


def scatter_sizes(timer: QuantiserScatter, noise: ModelNoise) -> Array:
    """Standard deviations of what a segment's readings have in common: both phases' zero, and each rest's volts."""
    volts = timer.sizes(noise.voltage_scatter_v, dithered=noise.dithered)
    return np.concatenate([[noise.offset_scatter_a] * 2, np.repeat(volts, 2)])


def _in_frame_of(piece: SegmentData, slopes: Array) -> Slopes:
    """Slopes in the frame of the rotor as it is believed to lie."""
    turn = rotation(-piece.segment.rotor_angle_rad)
    # As one product with a matrix of four by four: a product for each reading takes ten times as long.
    turned = slopes.reshape(-1, 4) @ np.kron(turn, turn).T
    return Slopes(np.zeros((0, 2, 2)), turned.reshape(-1, 2, 2))


def _beyond_rounding(change: Change, signals: SignalBatch) -> bool:
    """Whether there is more in a change than adding something and taking it away again leaves."""
    return any(
        float(np.abs(array).max()) > 1e3 * np.finfo(np.float64).eps * float(np.max(np.abs(array_of(signals, name))))
        for name, array in change.items()
    )
