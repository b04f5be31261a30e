"""One segment's equations where a model stands: what its effects make of the signals, the noise, and the columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import Active, typical_coordinate
from orchestrator.diagnosis.fitting.corrections import Corrected, apply_effects
from orchestrator.diagnosis.fitting.gauss_newton import is_stuck
from orchestrator.diagnosis.fitting.model import Model, SegmentFrame, SegmentRows
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
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.frames import rotation
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import EffectLayer, ParameterRole, Signals


@dataclass
class SegmentEquations:
    """Makes the equations of any segment of a recording; remembers the columns of those that no effect moves."""

    noise: SensorNoise
    pm_flux_wb: float
    criteria: Criteria
    _raw_basis: dict[str, tuple[EvenSpline, Array]] = field(default_factory=dict)

    def frame(self, model: Model, piece: SegmentSignals, old: SegmentFrame | None) -> SegmentFrame:
        """What is kept of a segment between steps, made anew as far as it changed since `old`."""
        s = piece.signals
        scale = model.r_s / ((s.motor.stator_resistance_ohm if s.motor else None) or 1.0)
        losses = s.losses and s.losses.model_copy(update={"power_w": s.losses.power_w * scale})
        base = s.model_copy(
            update={"resistance_ohm": np.full(len(s.v_dc), model.r_s), "losses": losses, "heat_j": s.heat_j * scale}
        )
        flux, seen = self._flux(piece, base, model)
        base = base.model_copy(update=flux)
        corrected = apply_effects(base, model.active)
        same = not corrected.changed & {"i_m_ab", "theta_rad"}
        local = seen if same else local_map(piece, corrected.signals, model.magnetics)
        mean = local.inductance.mean(axis=0)
        slopes = self._slopes(piece, base, model)
        alike = old is not None and not old.shaped_noise and slopes is None
        bearable = self.criteria.fitting.same_inductance * float(mean[[0, 2]].min())
        if old is not None and alike and np.abs(mean - old.mean_inductance).max() < bearable:
            whitener, mean = old.whitener, old.mean_inductance
        else:
            factor = np.asarray(corrected.signals.resistance_ohm / model.r_s, dtype=np.float64)
            whitener = Whitener(banded_covariance(piece, local, factor, self.noise, model.r_s, slopes))
        raw = self._untouched_basis(piece, local, model) if same else basis(piece, local, model.magnetics)
        if old is not None and whitener is old.whitener and raw is old.basis:
            white = old.white_basis
        else:
            white = whitener(raw if model.space.is_free else raw @ model.space.directions)
        return SegmentFrame(base, local, whitener, raw, white, mean, slopes is not None)

    def _untouched_basis(self, piece: SegmentSignals, local: LocalMap, model: Model) -> Array:
        known = self._raw_basis.get(piece.segment.id)
        if known is None or known[0] != model.space.grid:
            known = (model.space.grid, basis(piece, local, model.magnetics))
            self._raw_basis[piece.segment.id] = known
        return known[1]

    def _flux(self, piece: SegmentSignals, base: Signals, model: Model) -> tuple[dict[str, Array], LocalMap]:
        """Flux linkage in the stator frame, magnet included, as the effects see it; and the map it was read from."""
        outer = [a for a in model.active if a.candidate.effect.layer < EffectLayer.FRAME]
        inner = apply_effects(base, outer).signals
        local = local_map(piece, inner, model.magnetics)
        psi_ab, smooth, i_smooth = smooth_flux(
            local.psi,
            local.inductance,
            np.ascontiguousarray(inner.v_ab),
            np.ascontiguousarray(inner.i_ab),
            np.ascontiguousarray(inner.resistance_ohm),
            float(piece.segment.rotor_angle_rad),
            self.pm_flux_wb,
            1.0 / base.sampling_frequency_hz,
            self.criteria.weak_form.observer_time_constant_s,
        )
        return {"psi_ab": psi_ab, "psi_smooth_ab": smooth, "i_smooth_ab": i_smooth}, local

    def _slopes(self, piece: SegmentSignals, base: Signals, model: Model) -> Slopes | None:
        """How the inverter's effects multiply current noise, by shifting the measured current by its noise."""
        inverter = [a for a in model.active if a.candidate.effect.layer is EffectLayer.INVERTER]
        if not inverter or not base.bridge_on:
            return None
        turn = rotation(-piece.segment.rotor_angle_rad)
        voltage = np.empty((len(base.v_dc), 2, 2))
        sensor = self.noise.of(piece)
        for axis in range(2):
            shift = np.zeros(2)
            shift[axis] = math.sqrt(sensor[axis, axis])
            ahead, behind = (
                apply_effects(base.model_copy(update={"i_ab": base.i_ab + side * shift}), inverter).signals
                for side in (1.0, -1.0)
            )
            voltage[:, :, axis] = (ahead.v_ab - behind.v_ab) / (2.0 * shift[axis])
        return Slopes(np.zeros((0, 2, 2)), np.ascontiguousarray(turn @ voltage @ turn.T))

    def rows(
        self, model: Model, piece: SegmentSignals, frame: SegmentFrame, parameters: Sequence[tuple[Active, str]]
    ) -> SegmentRows:
        """The equations where the model stands, and a column for each of some parameters."""
        base, ordered = frame.base, sorted(model.active, key=lambda a: a.candidate.effect.layer)
        chain = [Corrected(base)]
        for active in ordered:
            chain.append(apply_effects(chain[-1].signals, [active]))
        corrected = chain[-1].signals
        local = local_map(piece, corrected, model.magnetics)
        known, resistance = voltage_and_resistance(
            piece,
            corrected.model_copy(update={"resistance_ohm": corrected.resistance_ohm / base.resistance_ohm[0]}),
            local,
            self.pm_flux_wb,
        )
        known = known + flux_terms(piece, local)
        sums = [self._column(piece, chain, ordered, local, a, n) for a, n in parameters]
        columns = [piece.windows.combine(np.stack(sums, axis=-1))] if sums else []
        white = frame.whitener(np.column_stack([known, resistance, *columns]))
        return SegmentRows(known, resistance, white)

    def _column(
        self,
        piece: SegmentSignals,
        chain: Sequence[Corrected],
        ordered: Sequence[Active],
        local: LocalMap,
        active: Active,
        name: str,
    ) -> Array:
        """Derivative of y by one parameter's coordinate, summed over samples; to typical size where it is absent.

        `chain` has the signals before each of the `ordered` effects and after the last, each with what the effect
        before it changed: those outside of the one that is moved need not be applied again.
        """
        p = active.candidate.named(name)
        x = active.coordinate(name)
        if p.role is not ParameterRole.AMPLITUDE:
            step = self.criteria.fitting.column_step * max(abs(x), 1.0)
        elif active.is_absent:
            step = typical_coordinate(p)
        else:
            step = self.criteria.fitting.column_step * max(abs(x), self.criteria.fitting.least_amplitude)
        if is_stuck(active, name, x + step):
            step = -step
        at = next((k for k, a in enumerate(ordered) if a.name == active.name), None)
        if at is None:
            at = sum(a.candidate.effect.layer <= active.candidate.effect.layer for a in ordered)
            inner = ordered[at:]
        else:
            inner = ordered[at + 1 :]
        other = apply_effects(chain[at].signals, [active.moved(name, x + step), *inner])
        changed = other.changed.union(*(c.changed for c in chain[at + 1 :]))
        return difference(piece, chain[-1].signals, other.signals, changed, local, self.pm_flux_wb) / step
