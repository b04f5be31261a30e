"""A batch's whitened equations at a model: corrected signals, noise covariance, residual and columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.columns import ColumnProbe
from orchestrator.diagnosis.fitting.corrections import (
    Cascade,
    Change,
    apply_effects,
    has_random_directions,
    step_of,
)
from orchestrator.diagnosis.fitting.model import (
    BatchLinearisation,
    ColumnName,
    DerivativeColumns,
    Model,
    SegmentLinearisation,
    SegmentRows,
)
from orchestrator.diagnosis.nuisances.carrier_ripple import CarrierRipple
from orchestrator.diagnosis.nuisances.pwm_quantiser import dwells, scatter_sizes, scatter_units
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import (
    LocalMap,
    basis,
    change_of_rows,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.noise import SensorNoise, Whitener, banded_covariance
from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import from_two_phases, inductance_to_ab, rotation, to_dq
from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import Correction, EffectLayer, SignalBatch

FLUX_ITERATIONS: int = 2
"""Fixed-point iterations of the flux that effects read, which itself depends on their rotor angle and magnetising
current. A twist of 0.03 rad reduces the error by as much in each. One suffices after an earlier evaluation."""
MAX_INDUCTANCE_CHANGE: float = 0.01
"""Relative change of the mean inductance up to which the noise covariance is reused."""
MAX_INVERTER_CHANGE: float = 0.1
"""Change of an inverter effect's standardised value x over max(1, |x|) up to which the covariance is reused."""

INDUCTANCE_STEP: float = 1e-3
"""Relative step of the inductance by which the voltages' derivatives are taken."""
OBSERVER_TIME_CONSTANT_S: float = 0.005
"""Time constant with which the integrated flux approaches the map's [s]: much longer than a ripple period, and short
compared with the integral's drift."""


@dataclass(frozen=True)
class BatchState:
    """A batch of segments evaluated at a model."""

    linearisation: BatchLinearisation
    cascade: Cascade
    local: LocalMap
    coefficients: Array
    """Those of the model's co-energy."""

    @property
    def batch(self) -> SegmentBatch:
        return self.linearisation.batch

    @property
    def is_held_out(self) -> bool:
        """Whether the batch is of held-out segments, which need no columns."""
        return self.batch.pieces[0].held_out


@dataclass
class WeakFormEquations:
    """Equations of any batch of a recording; map columns of batches that no effect changes are cached."""

    noise: SensorNoise
    pm_flux_wb: float
    ripples: bool = False
    """Whether the resistive drop of the ripple within a carrier period is included (`nuisances.carrier_ripple`)."""
    _raw_basis: dict[int, tuple[SegmentBatch, EvenSpline, list[Array]]] = field(default_factory=dict)

    def relinearise(self, model: Model, batch: SegmentBatch, old: BatchLinearisation | None) -> BatchState:
        """A batch evaluated at the model, linearised anew where it has changed since `old`.

        Both need only one pass of the signals through the effects.
        """
        linearisation, ripple = self._without_flux(model, batch)
        base = linearisation.base
        # Sensor lag and skin effect use the current without noise: the earlier one, else that of the present flux.
        if old is not None:
            base = base.replaced(_flux_of(old.base))
        elif model.active:
            base = base.replaced(self._flux(batch, base, model)[0])
        flux, seen = self._flux(batch, base, model)
        linearisation = linearisation.with_changed(flux)
        cascade = Cascade.of(base.replaced(flux), model.active)
        same = not cascade.changed & {"i_m_ab", "theta_rad"}
        local = seen if same else local_map(batch, cascade.corrected, model.magnetics)
        raw = self._untouched_basis(batch, local, model) if same else basis(batch, local, model.magnetics)
        follows = self._by_derivatives(linearisation, ripple, cascade, local, model)
        raw = [one if other is None else one + other.columns for one, other in zip(raw, follows, strict=True)]
        noises = self._noises(BatchState(linearisation, cascade, local, model.magnetics.coefficients), model, old)
        pieces = []
        for j, (whitener, mean, noise_parameters) in enumerate(noises):
            before = None if old is None else old.pieces[j]
            if before is not None and whitener is before.whitener and raw[j] is before.basis:
                white = before.white_basis
            else:
                white = whitener(raw[j] if model.space.is_free else raw[j] @ model.space.directions)
            pieces.append(SegmentLinearisation(whitener, raw[j], follows[j], white, mean, noise_parameters))
        return BatchState(replace(linearisation, pieces=tuple(pieces)), cascade, local, model.magnetics.coefficients)

    def at(self, model: Model, linearisation: BatchLinearisation) -> BatchState:
        """A batch evaluated at the model with an earlier linearisation."""
        cascade = Cascade.of(linearisation.base, model.active)
        local = local_map(linearisation.batch, cascade.corrected, model.magnetics)
        return BatchState(linearisation, cascade, local, model.magnetics.coefficients)

    def common(self, model: Model, linearisation: BatchLinearisation) -> list[Array]:
        """Whitened `_common_rows` of each segment."""
        state = self.at(model, linearisation)
        slopes = self._slopes(linearisation.batch, linearisation.base, model)
        return [cached.whitener(self._common_rows(state, j, slopes)) for j, cached in enumerate(linearisation.pieces)]

    def _without_flux(self, model: Model, batch: SegmentBatch) -> tuple[BatchLinearisation, list[CarrierRipple | None]]:
        """The measured signals with the model's resistance, its copper losses and damped ripple; each one's ripple."""
        plain = BatchLinearisation.of(batch, model.r_s)
        if not self.ripples:
            return plain, [None] * len(batch.pieces)
        base = plain.base
        ripple = [CarrierRipple.of(p, base.segment(j), model.magnetics) for j, p in enumerate(batch.pieces)]
        v_ab = base.v_ab.copy()
        for j, one in enumerate(ripple):
            if one is not None:
                v_ab[base.slice_of(j)] += one.damped()
        return plain.with_changed({"v_ab": v_ab}), ripple

    def _by_derivatives(
        self,
        linearisation: BatchLinearisation,
        ripple: Sequence[CarrierRipple | None],
        cascade: Cascade,
        local: LocalMap,
        model: Model,
    ) -> list[DerivativeColumns | None]:
        """Each segment's columns by which the voltages of ripple and effects follow the map.

        Where R_s T / L is large, these voltages determine the inductance in a hold. With it frozen, the map's step in
        response would be wrong, and the next linearisation further away.
        """
        found: list[DerivativeColumns | None] = [None] * len(ripple)
        if all(one is None for one in ripple):
            return found
        batch, base, grid = linearisation.batch, linearisation.base, model.space.grid
        step_h = INDUCTANCE_STEP * float(local.inductance[:, [0, 2]].mean())
        by_inductance = np.zeros((base.samples, 2, 3))
        for axis in range(3):
            change_h = step_h * np.eye(3)[axis]
            v_ab = base.v_ab.copy()
            for j, one in enumerate(ripple):
                if one is not None:
                    v_ab[base.slice_of(j)] += one.damped(change_h) - one.damped()
            inductance_ab = inductance_to_ab(local.inductance + change_h, batch.believed_rad)
            moved = Cascade.of(base.replaced({"v_ab": v_ab, "inductance_ab": inductance_ab}), model.active)
            by_inductance[:, :, axis] = (moved.corrected.v_ab - cascade.corrected.v_ab) / step_h
        for j, (piece, one) in enumerate(zip(batch.pieces, ripple, strict=True)):
            if one is None:
                continue
            weights = one.bent()
            bent = one.columns(weights, piece.windows, grid)
            weights[:] = 0.0
            for axis in range(3):
                weights[:, :, axis] = to_dq(by_inductance[base.slice_of(j), :, axis], one.angle)
            known = one.columns(weights, piece.windows, grid)
            found[j] = DerivativeColumns(bent + known, known @ model.magnetics.coefficients)
        return found

    def _noises(
        self, state: BatchState, model: Model, old: BatchLinearisation | None
    ) -> list[tuple[Whitener, Array, dict[ColumnName, float]]]:
        """Whitener, mean inductance and noise parameters of each segment, reused where the model has hardly moved."""
        batch, local, corrected = state.batch, state.local, state.cascade.corrected
        noise_parameters = self._noise_parameters(batch, model)
        means = np.add.reduceat(local.inductance, batch.layout.starts[:-1]) / np.diff(batch.layout.starts)[:, None]
        found: list[tuple[Whitener, Array, dict[ColumnName, float]] | None] = [None] * len(batch.pieces)
        if old is not None:
            same = self._same_noise(means, noise_parameters, old)
            found = [
                (cached.whitener, cached.mean_inductance, cached.noise_parameters) if as_before else None
                for cached, as_before in zip(old.pieces, same, strict=True)
            ]
        if all(one is not None for one in found):
            return [one for one in found if one is not None]
        slopes = self._slopes(batch, state.linearisation.base, model)
        directions = self._random_direction_rows(state)
        noises = []
        for j, (piece, known) in enumerate(zip(batch.pieces, found, strict=True)):
            if known is not None:
                noises.append(known)
                continue
            at = corrected.slice_of(j)
            part = local.part(at)
            turned = None if slopes is None else _in_frame_of(piece, slopes[at])
            factor = np.asarray(corrected.resistance_ohm[at] / model.r_s, dtype=np.float64)
            covariance = banded_covariance(piece, part, factor, self.noise, model.r_s, turned)
            common, scatter = [rows[batch.rows_of(j)] for rows in directions], self.noise.of_model
            if scatter.scatters:
                rows = self._common_rows(state, j, slopes)
                common.append(rows * scatter_sizes(scatter_units(piece), scatter))
            whitener = Whitener.of(covariance, np.column_stack(common) if common else None)
            noises.append((whitener, means[j], noise_parameters))
        return noises

    def _common_rows(self, state: BatchState, j: int, slopes: Array | None) -> Array:
        """Change of the equations by 1 A of offset in phase a or b and 1 V per axis and dwell, (rows, 2 + 2 dwells)."""
        # Moving voltages average out quantisation: only dwells get it. The offset acts through the inverter's slopes
        # too.
        at = state.cascade.corrected.slice_of(j)
        one, part = state.batch.singles[j], state.local.part(at)
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
        return np.stack([change_of_rows(one, corrected, c, part, self.pm_flux_wb) for c in changes], axis=-1)

    def _noise_parameters(self, batch: SegmentBatch, model: Model) -> dict[ColumnName, float]:
        """Standardised values of the effects that shape the noise: by multiplying it, or by random directions."""
        on = batch.pieces[0].signals.bridge_on
        effects = [a for a in model.active if on and (_multiplies_noise(a) or has_random_directions(a))]
        return {(a.name, p.name): a.standardised_value(p.name) for a in effects for p in a.candidate.parameters}

    def _random_direction_rows(self, state: BatchState) -> list[Array]:
        """Change of the equations by one standard deviation along each random direction, each of shape (rows,)."""
        at, magnet = state.cascade.corrected, self.pm_flux_wb
        directions = state.cascade.random_directions()
        return [change_of_rows(state.batch, at, change, state.local, magnet) for change in directions]

    def _same_noise(
        self, inductances: Array, noise_parameters: dict[ColumnName, float], old: BatchLinearisation
    ) -> list[bool]:
        """For each segment, whether an earlier linearisation's noise covariance still holds."""
        is_same = dict[int, bool]()
        before = np.stack([cached.mean_inductance for cached in old.pieces])
        moved = np.abs(inductances - before).max(axis=1)
        bearable = MAX_INDUCTANCE_CHANGE * inductances[:, [0, 2]].min(axis=1)
        # Segments whose noise was computed in one call share the dictionary of parameters.
        for known in (cached.noise_parameters for cached in old.pieces):
            if id(known) not in is_same:
                is_same[id(known)] = noise_parameters.keys() == known.keys() and all(
                    abs(x - known[k]) <= MAX_INVERTER_CHANGE * max(abs(x), 1.0) for k, x in noise_parameters.items()
                )
        return [
            bool(steady) and is_same[id(cached.noise_parameters)]
            for cached, steady in zip(old.pieces, moved < bearable, strict=True)
        ]

    def _untouched_basis(self, batch: SegmentBatch, local: LocalMap, model: Model) -> list[Array]:
        known = self._raw_basis.get(id(batch))
        if known is None or known[1] != model.space.grid:
            known = (batch, model.space.grid, basis(batch, local, model.magnetics))
            self._raw_basis[id(batch)] = known
        return known[2]

    def _flux(self, batch: SegmentBatch, base: SignalBatch, model: Model) -> tuple[dict[str, Array], LocalMap]:
        """Flux linkage in the stator frame, magnet included, for the effects; and the local map it was read from.

        Where effects change the rotor angle or the magnetising current, the map is read again there, iterating from
        the first flux or from that of `base`, which belongs to a similar model.
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
            signals = moved.signals
            at = inner.replaced({"theta_rad": signals.theta_rad})
            found = self._flux_read(batch, at, local_map(batch, signals, model.magnetics))
        return found, local

    def _flux_read(self, batch: SegmentBatch, signals: SignalBatch, local: LocalMap) -> dict[str, Array]:
        """The flux quantities that effects read, by the signals' names."""
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
        """d v_impressed / d i_measured in the stator frame [ohm], shape (n, 2, 2); None without such effects."""
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
        """Each segment's equations at a model, with a column for each given parameter.

        Parameters
        ----------
        answering : sequence of frozenset of str, optional
            For each column, the inner effects that respond to it; all by default.
        """
        inner_effects = answering if answering is not None else repeat(None)
        out = _empty(at.batch, len(parameters))
        for k, ((active, name), inner) in enumerate(zip(parameters, inner_effects, strict=False)):
            step, change, _ = _changed(at, active, name, inner)
            self._difference(at, change, step, out[:, 2 + k])
        return self._white(at, out)

    def probed(
        self, at: BatchState, parameters: Sequence[tuple[EffectTerm, str]], answering: Sequence[frozenset[str] | None]
    ) -> tuple[list[SegmentRows], list[ColumnProbe]]:
        """`rows`, and the contribution of each inner effect to each column whose responses are not known yet."""
        out = _empty(at.batch, len(parameters))
        keys, additions = [], []
        for k, ((active, name), inner) in enumerate(zip(parameters, answering, strict=True)):
            step, change, responses = _changed(at, active, name, inner)
            self._difference(at, change, step, out[:, 2 + k])
            for effect, response in responses.items():
                keys.append((k, effect))
                additions.append(self._difference(at, response, step))
        rows = self._white(at, out)
        together = np.stack(additions, axis=-1) if additions else np.zeros((int(at.batch.layout.rows[-1]), 0))
        probes = []
        for j, cached in enumerate(at.linearisation.pieces):
            power = np.sum(cached.whitener(together[at.batch.rows_of(j)]) ** 2, axis=0)
            probes.append(ColumnProbe(rows[j].columns, dict(zip(keys, power.tolist(), strict=True))))
        return rows, probes

    def _white(self, at: BatchState, out: Array) -> list[SegmentRows]:
        """Each segment's equations at a model, whitened with the columns in `out[:, 2:]`."""
        corrected, r_s = at.cascade.corrected, at.linearisation.r_s
        in_parts = corrected.replaced({"resistance_ohm": corrected.resistance_ohm / r_s})
        voltage, resistance = voltage_and_resistance(at.batch, in_parts, at.local, self.pm_flux_wb)
        known = voltage + flux_terms(at.batch, at.local)
        for j, cached in enumerate(at.linearisation.pieces):
            if cached.by_derivatives is not None:
                follows = cached.by_derivatives
                known[at.batch.rows_of(j)] += follows.columns @ at.coefficients - follows.known
        out[:, 0], out[:, 1] = known, resistance
        rows = []
        for j, cached in enumerate(at.linearisation.pieces):
            own_rows = at.batch.rows_of(j)
            rows.append(SegmentRows(known[own_rows], resistance[own_rows], cached.whitener(out[own_rows])))
        return rows

    def _difference(self, at: BatchState, change: Change, step: float, out: Array | None = None) -> Array:
        rows = change_of_rows(at.batch, at.cascade.corrected, change, at.local, self.pm_flux_wb, out)
        rows /= step
        return rows


def _empty(batch: SegmentBatch, parameters: int) -> Array:
    """Array for the equations of a batch before whitening, shape (rows, 2 + parameters), column by column."""
    return np.empty((int(batch.layout.rows[-1]), 2 + parameters), order="F")


def _changed(
    at: BatchState, active: EffectTerm, name: str, answering: frozenset[str] | None
) -> tuple[float, Change, dict[str, Change]]:
    """Step of one standardised parameter, the signals' change by it, and the parts of inner effects in that."""
    step = step_of(active, name)
    return step, *at.cascade.change_by(active.moved(name, active.standardised_value(name) + step), answering)


FLUX = ("psi_ab", "psi_smooth_ab", "i_smooth_ab", "inductance_ab")
"""Names of the signals that hold the model's flux for the effects."""


def _flux_of(signals: SignalBatch) -> dict[str, Array]:
    return {name: getattr(signals, name) for name in FLUX}


def _multiplies_noise(active: EffectTerm) -> bool:
    return active.candidate.effect.layer is EffectLayer.INVERTER and not active.is_absent


def _in_frame_of(piece: SegmentData, slopes: Array) -> Array:
    """Slopes in the believed rotor frame."""
    turn = rotation(-piece.segment.rotor_angle_rad)
    # One product with a 4 x 4 matrix; a product per reading takes ten times as long.
    return np.asarray((slopes.reshape(-1, 4) @ np.kron(turn, turn).T).reshape(-1, 2, 2))
