"""One segment's equations where a model stands: what its effects make of the signals, the noise, and the columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import repeat

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.cascade import Cascade, Change, array_of, step_of
from orchestrator.diagnosis.fitting.columns import ColumnProbe
from orchestrator.diagnosis.fitting.corrections import apply_effects, is_doubtful
from orchestrator.diagnosis.fitting.model import ColumnName, Model, SegmentFrame, SegmentRows
from orchestrator.diagnosis.weak_form.carrier_ripple import taken_of_ripple
from orchestrator.diagnosis.weak_form.equations import (
    LocalMap,
    basis,
    difference,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.noise import SensorNoise, Slopes, Whitener, banded_covariance
from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.diagnosis.weak_form.rests import TimerScatter, rests
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.frames import from_two_phases, inductance_to_ab, rotation
from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import Correction, EffectLayer, ModelNoise, Signals


@dataclass(frozen=True)
class Place:
    """A segment where a model stands."""

    piece: SegmentSignals
    frame: SegmentFrame
    cascade: Cascade
    local: LocalMap


@dataclass
class SegmentEquations:
    """Makes the equations of any segment of a recording; remembers the columns of those that no effect moves."""

    noise: SensorNoise
    pm_flux_wb: float
    criteria: Criteria
    ripples: bool = False
    """Whether the resistance takes its part of a carrier's ripple (`weak_form.carrier_ripple`)."""
    _raw_basis: dict[str, tuple[EvenSpline, Array]] = field(default_factory=dict)

    def renewed(self, model: Model, piece: SegmentSignals, old: SegmentFrame | None) -> Place:
        """A segment where the model stands, in a frame made anew as far as it changed since `old`.

        Its signals are led through the effects but once for both.
        """
        s = piece.signals
        # On its way to where it fits R_s may be below nothing; a loss is not.
        scale = max(model.r_s, 0.0) / ((s.motor.stator_resistance_ohm if s.motor else None) or 1.0)
        losses = s.losses and s.losses.model_copy(update={"power_w": s.losses.power_w * scale})
        base = s.model_copy(
            update={"resistance_ohm": np.full(len(s.v_dc), model.r_s), "losses": losses, "heat_j": s.heat_j * scale}
        )
        if self.ripples:
            base = base.replaced({"v_ab": base.v_ab + taken_of_ripple(piece, base, model.magnetics)})
        # A sensor's lag and skin effect are told by the current without noise: by that of before, or else of this flux.
        if old is not None:
            base = base.replaced(_flux_of(old.base))
        elif model.active:
            base = base.replaced(self._flux(piece, base, model)[0])
        flux, seen = self._flux(piece, base, model)
        base = base.replaced(flux)
        cascade = Cascade.of(base, model.active)
        corrected = cascade.corrected
        same = not cascade.changed & {"i_m_ab", "theta_rad"}
        local = seen if same else local_map(piece, corrected, model.magnetics)
        mean = local.inductance.mean(axis=0)
        carriers = self._carriers(piece, model)
        if old is not None and self._same_noise(mean, carriers, old):
            whitener, mean, carriers = old.whitener, old.mean_inductance, old.carried_by
        else:
            slopes = self._slopes(piece, base, model)
            turned = None if slopes is None else _in_frame_of(piece, slopes)
            factor = np.asarray(corrected.resistance_ohm / model.r_s, dtype=np.float64)
            covariance = banded_covariance(piece, local, factor, self.noise, model.r_s, turned)
            common, scatter = self._doubted_rows(piece, cascade, local), self.noise.of_model
            if scatter.scatters:
                rows = self._common_rows(piece, corrected, local, slopes)
                common.append(rows * scatter_sizes(TimerScatter.of(piece), scatter))
            whitener = Whitener.of(covariance, np.column_stack(common) if common else None)
        raw = self._untouched_basis(piece, local, model) if same else basis(piece, local, model.magnetics)
        if old is not None and whitener is old.whitener and raw is old.basis:
            white = old.white_basis
        else:
            white = whitener(raw if model.space.is_free else raw @ model.space.directions)
        return Place(piece, SegmentFrame(base, whitener, raw, white, mean, carriers), cascade, local)

    def place(self, model: Model, piece: SegmentSignals, frame: SegmentFrame) -> Place:
        """A segment where the model stands, in a frame of before."""
        cascade = Cascade.of(frame.base, model.active)
        return Place(piece, frame, cascade, local_map(piece, cascade.corrected, model.magnetics))

    def common(self, model: Model, piece: SegmentSignals, frame: SegmentFrame) -> Array:
        """What a segment's readings may have in common, whitened: columns as of `_common_rows`."""
        corrected = apply_effects(frame.base, model.active).signals
        local = local_map(piece, corrected, model.magnetics)
        slopes = self._slopes(piece, frame.base, model)
        return frame.whitener(self._common_rows(piece, corrected, local, slopes))

    def _common_rows(self, piece: SegmentSignals, corrected: Signals, local: LocalMap, slopes: Array | None) -> Array:
        """What one ampere on all readings of phase a, and of phase b, does to the equations, and a volt on each axis.

        The volt is that of each rest, for a voltage that moves is dithered. The ampere acts through the voltage, too,
        by the inverter's slopes (n, 2, 2). Shape (rows, 2 + 2 rests).
        """
        sums = []
        for phases in (1.0, 0.0), (0.0, 1.0):
            off = np.empty((len(corrected.v_dc), 2))
            off[:] = from_two_phases(*phases)
            change: Change = {"i_ab": off, "i_m_ab": off}
            if slopes is not None:
                change["v_ab"] = np.ascontiguousarray(slopes @ from_two_phases(*phases))
            sums.append(difference(piece, corrected, change, local, self.pm_flux_wb))
        for rest in rests(piece):
            for axis in np.eye(2):
                volt = np.zeros((len(corrected.v_dc), 2))
                volt[rest] = axis
                sums.append(difference(piece, corrected, {"v_ab": volt}, local, self.pm_flux_wb))
        return piece.windows.combine(np.stack(sums, axis=-1))

    def _carriers(self, piece: SegmentSignals, model: Model) -> dict[ColumnName, float]:
        """Coordinates of the effects that have a part in the noise: that multiply it, or do not know all they do."""
        on = piece.signals.bridge_on
        there = [a for a in model.active if on and (_multiplies_noise(a) or is_doubtful(a))]
        return {(a.name, p.name): a.coordinate(p.name) for a in there for p in a.candidate.parameters}

    def _doubted_rows(self, piece: SegmentSignals, cascade: Cascade, local: LocalMap) -> list[Array]:
        """What each doubt of an effect does to the equations, one standard deviation of it: shape (rows, doubts)."""
        at, magnet = cascade.corrected, self.pm_flux_wb
        sums = [difference(piece, at, change, local, magnet) for change in cascade.doubts()]
        return [piece.windows.combine(np.stack(sums, axis=-1))] if sums else []

    def _same_noise(self, inductance: Array, carriers: dict[ColumnName, float], old: SegmentFrame) -> bool:
        """Whether the noise's covariance bears what has moved since an earlier frame."""
        limits = self.criteria.fitting
        bearable = limits.same_inductance * float(inductance[[0, 2]].min())
        if np.abs(inductance - old.mean_inductance).max() >= bearable or carriers.keys() != old.carried_by.keys():
            return False
        return all(abs(x - old.carried_by[k]) <= limits.same_inverter * max(abs(x), 1.0) for k, x in carriers.items())

    def _untouched_basis(self, piece: SegmentSignals, local: LocalMap, model: Model) -> Array:
        known = self._raw_basis.get(piece.segment.id)
        if known is None or known[0] != model.space.grid:
            known = (model.space.grid, basis(piece, local, model.magnetics))
            self._raw_basis[piece.segment.id] = known
        return known[1]

    def _flux(self, piece: SegmentSignals, base: Signals, model: Model) -> tuple[dict[str, Array], LocalMap]:
        """Flux linkage in the stator frame, magnet included, as the effects see it; and the map it was read from.

        Where the rotor does not lie as it is believed to, or not all of the current magnetises, the map is read again
        where it does, as far as that flux tells; or the one that `base` knows already, of much the same model.
        """
        outer = [a for a in model.active if a.candidate.effect.layer < EffectLayer.FRAME]
        moving = [a for a in model.active if a.candidate.effect.layer >= EffectLayer.FRAME and not a.is_absent]
        inner = apply_effects(base, outer).signals
        local = local_map(piece, inner, model.magnetics)
        if not moving:
            return self._flux_read(piece, inner, local), local
        known = base.psi_ab is not None
        found = _flux_of(base) if known else self._flux_read(piece, inner, local)
        for _ in range(1 if known else self.criteria.fitting.flux_turns):
            moved = apply_effects(inner.replaced(found), moving)
            if not moved.changed & {"theta_rad", "i_m_ab"}:
                return self._flux_read(piece, inner, local), local
            there = moved.signals
            at = inner.replaced({"theta_rad": there.theta_rad})
            found = self._flux_read(piece, at, local_map(piece, there, model.magnetics))
        return found, local

    def _flux_read(self, piece: SegmentSignals, signals: Signals, local: LocalMap) -> dict[str, Array]:
        """What effects see of the flux, by the signals' names."""
        turned = len(local.delta) > 0
        theta = signals.theta_rad if turned else float(piece.segment.rotor_angle_rad)
        psi_ab, smooth, i_smooth = smooth_flux(
            local.psi,
            local.inductance,
            np.ascontiguousarray(signals.v_ab),
            np.ascontiguousarray(signals.i_ab),
            np.ascontiguousarray(signals.resistance_ohm),
            unit_vectors(np.atleast_1d(np.ascontiguousarray(theta, dtype=np.float64))),
            self.pm_flux_wb,
            1.0 / signals.sampling_frequency_hz,
            self.criteria.weak_form.observer_time_constant_s,
        )
        inductance = inductance_to_ab(local.inductance, theta)
        return dict(zip(FLUX, (psi_ab, smooth, i_smooth, inductance), strict=True))

    def _slopes(self, piece: SegmentSignals, base: Signals, model: Model) -> Array | None:
        """How the inverter's effects multiply current noise, by shifting the measured current by its noise.

        d v_impressed / d i_measured in the stator frame [ohm], shape (n, 2, 2); None where no effect does.
        """
        inverter = [a for a in model.active if _multiplies_noise(a)]
        if not (inverter and piece.signals.bridge_on):
            return None
        voltage = np.empty((len(base.v_dc), 2, 2))
        sensor = self.noise.of(piece)
        for axis in range(2):
            shift = np.zeros(2)
            shift[axis] = math.sqrt(sensor[axis, axis])
            ahead, behind = (
                apply_effects(base.corrected(Correction(i_ab=base.i_ab + side * shift)), inverter).signals
                for side in (1.0, -1.0)
            )
            voltage[:, :, axis] = (ahead.v_ab - behind.v_ab) / (2.0 * shift[axis])
        return voltage

    def rows(
        self,
        at: Place,
        parameters: Sequence[tuple[Active, str]] = (),
        answering: Sequence[frozenset[str] | None] | None = None,
    ) -> SegmentRows:
        """The equations at a place, and a column for each of some parameters.

        Parameters
        ----------
        answering : sequence of frozenset of str, optional
            Of every column the inner effects that answer to it; all by default.
        """
        asked = answering if answering is not None else repeat(None)
        return self._white(
            at, [self._column(at, a, n, inner)[0] for (a, n), inner in zip(parameters, asked, strict=False)]
        )

    def probed(
        self, at: Place, parameters: Sequence[tuple[Active, str]], answering: Sequence[frozenset[str] | None]
    ) -> tuple[SegmentRows, ColumnProbe]:
        """The same, and what each inner effect has to do with each column of which that is not known."""
        sums, keys, heard = [], [], []
        for k, ((active, name), inner) in enumerate(zip(parameters, answering, strict=True)):
            column, answers = self._column(at, active, name, inner)
            sums.append(column)
            for effect, added in answers.items():
                keys.append((k, effect))
                heard.append(added)
        rows = self._white(at, sums)
        white = at.frame.whitener(at.piece.windows.combine(np.stack(heard, axis=-1))) if heard else np.zeros((1, 0))
        power = np.sum(white**2, axis=0)
        return rows, ColumnProbe(rows.columns, {key: float(p) for key, p in zip(keys, power, strict=True)})

    def _white(self, at: Place, sums: Sequence[Array]) -> SegmentRows:
        """The equations at a place with sums over samples as columns."""
        corrected, r_s = at.cascade.corrected, at.frame.base.resistance_ohm[0]
        known, resistance = voltage_and_resistance(
            at.piece,
            corrected.replaced({"resistance_ohm": corrected.resistance_ohm / r_s}),
            at.local,
            self.pm_flux_wb,
        )
        known = known + flux_terms(at.piece, at.local)
        columns = [at.piece.windows.combine(np.stack(sums, axis=-1))] if sums else []
        return SegmentRows(known, resistance, at.frame.whitener(np.column_stack([known, resistance, *columns])))

    def _column(
        self, at: Place, active: Active, name: str, answering: frozenset[str] | None = None
    ) -> tuple[Array, dict[str, Array]]:
        """Derivative of y by one parameter's coordinate, summed over samples, and what inner effects had in it."""
        step = step_of(active, name, self.criteria.fitting)
        change, answers = at.cascade.change_by(active.moved(name, active.coordinate(name) + step), answering)
        said = {n: self._sums(at, c, step) for n, c in answers.items() if _beyond_rounding(c, at.cascade.corrected)}
        return self._sums(at, change, step), said

    def _sums(self, at: Place, change: Change, step: float) -> Array:
        return difference(at.piece, at.cascade.corrected, change, at.local, self.pm_flux_wb) / step


FLUX = ("psi_ab", "psi_smooth_ab", "i_smooth_ab", "inductance_ab")
"""What effects see of a model's flux, by the signals' names."""


def _flux_of(signals: Signals) -> dict[str, Array]:
    return {name: getattr(signals, name) for name in FLUX}


def _multiplies_noise(active: Active) -> bool:
    return active.candidate.effect.layer is EffectLayer.INVERTER and not active.is_absent


def scatter_sizes(timer: TimerScatter, noise: ModelNoise) -> Array:
    """Standard deviations of what a segment's readings have in common: both phases' zero, and each rest's volts."""
    volts = timer.sizes(noise.voltage_scatter_v, dithered=noise.dithered)
    return np.concatenate([[noise.offset_scatter_a] * 2, np.repeat(volts, 2)])


def _in_frame_of(piece: SegmentSignals, slopes: Array) -> Slopes:
    """Slopes in the frame of the rotor as it is believed to lie."""
    turn = rotation(-piece.segment.rotor_angle_rad)
    # As one product with a matrix of four by four: a product for each reading takes ten times as long.
    turned = slopes.reshape(-1, 4) @ np.kron(turn, turn).T
    return Slopes(np.zeros((0, 2, 2)), turned.reshape(-1, 2, 2))


def _beyond_rounding(change: Change, signals: Signals) -> bool:
    """Whether there is more in a change than adding something and taking it away again leaves."""
    return any(
        float(np.abs(array).max()) > 1e3 * np.finfo(np.float64).eps * float(np.max(np.abs(array_of(signals, name))))
        for name, array in change.items()
    )
