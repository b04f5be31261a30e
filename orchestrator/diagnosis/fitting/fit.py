"""Fit of the model to the weak form: R_s, the co-energy's coefficients, and the parameters of active effects.

The equations are linear in R_s and the coefficients, so these are solved for exactly at every step (variable
projection); the effects' parameters move by Gauss-Newton with unit normal priors. What changes little from step
to step (the map's columns, the noise, the flux that effects see) is a `Frame`, renewed when the model has moved:
the equations themselves are always evaluated where the model stands. Decides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from orchestrator.diagnosis.criteria import FittingCriteria
from orchestrator.diagnosis.fitting.candidates import Active, Candidate, typical_coordinate
from orchestrator.diagnosis.fitting.corrections import Corrected, apply_effects
from orchestrator.diagnosis.fitting.gauss_newton import is_stuck, moved_by, newton_step
from orchestrator.diagnosis.fitting.model import Fit, Frame, MapSpace, Model, SegmentFrame, SegmentRows
from orchestrator.diagnosis.weak_form.equations import (
    LocalMap,
    basis,
    difference,
    flux_terms,
    local_map,
    voltage_and_resistance,
)
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.noise import SensorNoise, Slopes, Whitener, banded_covariance
from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentSignals
from orchestrator.numerics.frames import rotation
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import EffectLayer, ParameterRole, Signals

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


@dataclass
class Effort:
    """How much was computed, in samples times columns: the same on every machine, unlike time."""

    most: float = math.inf
    spent: float = 0.0

    @property
    def exhausted(self) -> bool:
        return self.spent > self.most


@dataclass
class Fitter:
    """One recording, ready to be fitted again and again.

    Attributes
    ----------
    prepared : PreparedRecording
    noise : SensorNoise
    pm_flux_wb : float
    effort : Effort
        Of all fits; a search ends where it is exhausted.
    poll : callable
        Called before each evaluation; what it raises ends the fit.
    """

    prepared: PreparedRecording
    noise: SensorNoise
    pm_flux_wb: float
    threads: int = 2
    effort: Effort = field(default_factory=Effort)
    poll: Callable[[], None] = lambda: None
    _raw_basis: dict[str, tuple[EvenSpline, Array]] = field(default_factory=dict)

    @property
    def criteria(self) -> FittingCriteria:
        return self.prepared.criteria.fitting

    def fit(
        self, model: Model, frame: Frame | None = None, *, steps: int = 8, renewals: int = 2, tolerance: float = 1e-4
    ) -> Fit:
        """Fit R_s, the map and every free parameter, from where the model stands.

        Parameters
        ----------
        frame : Frame, optional
            Kept from an earlier fit with the same map space.
        steps : int
            Most Gauss-Newton steps in one frame.
        renewals : int
            How often the frame is renewed and the fit continued.
        tolerance : float
            Gain of a step, as a part of the excess chi2, below which the fit ends.
        """
        if frame is None or frame.space is not model.space:
            frame = self.frame(model)
        best = self._descend(self.evaluate(model, frame), steps, tolerance)
        for _ in range(renewals):
            old = best
            best = self._descend(self.evaluate(best.model, self.frame(best.model, best.frame)), steps, tolerance)
            if abs(best.chi2 - old.chi2) < self.criteria.renewal_change * best.chi2:
                break
        return best

    def _descend(self, best: Fit, steps: int, tolerance: float) -> Fit:
        damping, limits = 0.0, self.criteria
        for _ in range(steps if best.model.free else 0):
            system = best.projected()
            enough = limits.least_gain + tolerance * max(best.chi2 - best.dof, 0.0)
            promised = newton_step(best, system, 0.0)[1]
            if promised < enough:
                break
            while True:
                move, _ = newton_step(best, system, damping)
                trial = self._resized(self.evaluate(moved_by(best.model, move), best.frame), best.objective)
                missed = trial.objective >= best.objective + limits.slack
                if not missed or damping > limits.most_damping or promised < limits.least_promise:
                    break
                damping = max(10.0 * damping, limits.least_damping)
            gain = best.objective - trial.objective
            if gain > -limits.slack:
                best = trial
            if gain < enough:
                break
            # Where a step had to be damped, the next one most likely has to be too.
            if gain > limits.promise_kept * promised:
                damping = 0.1 * damping if damping > limits.least_damping else 0.0
        return best

    def promise(self, fit: Fit) -> float:
        """How far one more step would bring the objective down, if all were linear."""
        return newton_step(fit, fit.projected(), 0.0)[1]

    def _resized(self, trial: Fit, wanted: float) -> Fit:
        """A trial that missed, with the amplitudes that belong to its shapes.

        Amplitude and shape of an effect lie along a curved valley (a heating's size and its time constant); a step
        straight ahead leaves it, and the amplitudes alone, in which the residual is nearly linear, lead back.
        """
        sizes = np.array([name in active.candidate.amplitudes for active, name in trial.model.free])
        if trial.objective < wanted or sizes.all():
            return trial
        move, _ = newton_step(trial, trial.projected(), 0.0, sizes)
        again = self.evaluate(moved_by(trial.model, move), trial.frame)
        return again if again.objective < trial.objective else trial

    def frame(self, model: Model, old: Frame | None = None) -> Frame:
        """All that is kept between steps, made anew where the model stands, as far as it changed since `old`."""
        if old is not None and old.space is not model.space:
            old = None
        before = old.pieces if old is not None else (None,) * len(self.prepared.pieces)
        jobs = list(zip(self.prepared.pieces, before, strict=True))
        pieces = tuple(self._map(lambda job: self._segment_frame(model, *job), jobs))
        if old is not None and all(a.white_basis is b.white_basis for a, b in zip(pieces, old.pieces, strict=True)):
            return Frame(model.space, pieces, old.gram)
        free = model.space.directions.shape[1]
        gram = np.zeros((free, free))
        for piece, segment_frame in zip(self.prepared.pieces, pieces, strict=True):
            if not piece.held_out:
                gram += segment_frame.white_basis.T @ segment_frame.white_basis
        return Frame(model.space, pieces, gram)

    def evaluate(
        self, model: Model, frame: Frame, extra: Sequence[tuple[Active, str]] = (), *, held: bool = False
    ) -> Fit:
        """Solve for R_s and the map with the effects where they are; `extra` asks for more columns.

        With `held` nothing is solved for: R_s and the map stay the model's too.
        """
        self.poll()
        wanted = [*model.free, *extra]
        samples = sum(len(p.signals.v_dc) for p in self.prepared.pieces)
        self.effort.spent += samples * (len(wanted) + self.criteria.evaluation_columns)
        jobs = list(zip(self.prepared.pieces, frame.pieces, strict=True))
        rows = self._map(lambda job: self.segment_rows(model, job[0], job[1], wanted), jobs)
        return self._solve(model, frame, rows, held)

    def hold(self, model: Model) -> Fit:
        """The recording held against a model as it stands: nothing is fitted, the noise is what it makes of it.

        chi2 is per degree of freedom as in a fit of the same freedom.
        """
        return self.evaluate(model, self.frame(model), held=True)

    def _map(self, work: Callable[[_Job], _Result], jobs: Sequence[_Job]) -> list[_Result]:
        if self.threads < 2:
            return [work(job) for job in jobs]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(work, jobs))

    def _segment_frame(self, model: Model, piece: SegmentSignals, old: SegmentFrame | None) -> SegmentFrame:
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
        bearable = self.criteria.same_inductance * float(mean[[0, 2]].min())
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
            self.prepared.criteria.weak_form.observer_time_constant_s,
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

    def segment_rows(
        self, model: Model, piece: SegmentSignals, segment_frame: SegmentFrame, parameters: Sequence[tuple[Active, str]]
    ) -> SegmentRows:
        base, ordered = segment_frame.base, sorted(model.active, key=lambda a: a.candidate.effect.layer)
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
        white = segment_frame.whitener(np.column_stack([known, resistance, *columns]))
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
            step = self.criteria.column_step * max(abs(x), 1.0)
        elif active.is_absent:
            step = typical_coordinate(p)
        else:
            step = self.criteria.column_step * max(abs(x), self.criteria.least_amplitude)
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

    def _solve(self, model: Model, frame: Frame, rows: Sequence[SegmentRows], held: bool) -> Fit:
        space, pieces = model.space, self.prepared.pieces
        width = 1 + space.directions.shape[1]
        normal, right = np.zeros((width, width)), np.zeros(width)
        normal[1:, 1:] = frame.gram
        for piece, segment_frame, row in zip(pieces, frame.pieces, rows, strict=True):
            if piece.held_out:
                continue
            e, r = row.white[:, 0], row.white[:, 1]
            normal[0, 0] += r @ r
            normal[0, 1:] += r @ segment_frame.white_basis
            right[0] += r @ e
            right[1:] += segment_frame.white_basis.T @ e
        normal[1:, 0] = normal[0, 1:]
        total = normal.copy()
        total[1:, 1:] += space.prior.T @ space.prior
        # Equations are written around the model's own coefficients; the prior is around the space's origin.
        free_numbers = _free_numbers(space, model.magnetics.coefficients)
        right[1:] += space.prior.T @ (space.prior @ free_numbers)
        solution = np.append(model.r_s, np.zeros(width - 1)) if held else -np.linalg.solve(total, right)
        effective = float(np.trace(np.linalg.solve(total, normal)))
        r_s, change = float(solution[0]), solution[1:]
        moved = space.directions @ change
        fitted = replace(model, r_s=r_s, magnetics=Magnetics(space.grid, model.magnetics.coefficients + moved))
        residual, volts = [], []
        for piece, segment_frame, row in zip(pieces, frame.pieces, rows, strict=True):
            residual.append(row.white[:, 0] + row.white[:, 1] * r_s + segment_frame.white_basis @ change)
            raw = row.known + row.resistance * r_s + segment_frame.basis @ moved
            volts.append(raw * piece.signals.sampling_frequency_hz / piece.windows.absolute_weight())
        training = [e for p, e in zip(pieces, residual, strict=True) if not p.held_out]
        chi2 = float(sum(e @ e for e in training))
        log_det = sum(f.whitener.log_det for p, f in zip(pieces, frame.pieces, strict=True) if not p.held_out)
        priors = sum(a.coordinate(n) ** 2 for a, n in model.free)
        rough = space.prior @ (free_numbers + change)
        return Fit(
            model=fitted,
            frame=frame,
            prepared=self.prepared,
            chi2=chi2,
            objective=chi2 + log_det + priors + float(rough @ rough),
            log_det=log_det,
            dof=max(sum(len(e) for e in training) - effective - len(model.free), 1.0),
            residual=tuple(residual),
            volts=tuple(volts),
            normal=total,
            columns=tuple(row.white[:, 2:] for row in rows),
            resistance=tuple(row.white[:, 1] for row in rows),
        )


def _free_numbers(space: MapSpace, coefficients: Array) -> Array:
    if space.directions.shape[1] == 0:
        return np.zeros(0)
    if space.is_free:
        return coefficients - space.origin
    return np.asarray(np.linalg.lstsq(space.directions, coefficients - space.origin, rcond=None)[0])


def absent_columns(candidates: Sequence[Candidate]) -> list[tuple[Active, str]]:
    """Every amplitude of effects that are not in the model, as `Fitter.evaluate` takes them."""
    return [(c.absent(), n) for c in candidates for n in c.amplitudes]
