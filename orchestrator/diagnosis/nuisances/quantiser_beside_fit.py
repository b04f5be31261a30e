"""Estimate of a modulator's timer from all equations of a fit, once all effects have nearly their final forms.

Dwells give the first estimate while forms are still wrong (`quantiser_in_dwells`). The change of the equations by a
timer's rounding is exact; R_s, the map and all free parameters adapt to first order (variable projection; G. Golub,
V. Pereyra, doi:10.1137/0710036). With g the change of the whitened residual e, X the columns of the adapting
parameters, N their normal matrix and C the curvature of the readings' likelihood of x,

    cost(x) = 2 e^T g + g^T g - (X^T g)^T N^-1 (X^T g) + x^T C x
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, added_by, leg_step_of
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import LocalMap, change_of_rows, local_map
from orchestrator.diagnosis.weak_form.noise import Whitener
from orchestrator.diagnosis.weak_form.segments import SegmentData, mean_between
from orchestrator.numerics.types import Array, Indices
from protocols import ModulatorTimer, SignalBatch

DIFFERENCE_STEPS = (0.02, 0.004)
"""Finite-difference steps of successive descents, in timer steps at the largest command.

Rounding jumps where a held command crosses a step; wide differences bridge such jumps.
"""
SCANNED_PHASES = 96
"""Phases tried at a PWM frequency where the readings determine none; commands of a dwell jump as often."""
SCANNED_NEARBY = 6
"""Neighbouring steps and phases tried after a descent, whose minimum may lie beyond a command's jump."""
MAX_NEWTON_STEPS = 12
"""Maximum number of Gauss-Newton steps."""
LEAST_CHI2_GAIN = 1.0
"""Fall of chi2 in a step below which the descent ends."""
FIRST_DAMPING = 0.1
MAX_DAMPING = 1e3


def quantiser_beside(
    fit: Fit, estimates: Sequence[QuantiserEstimate], pm_flux_wb: float
) -> tuple[ModulatorTimer, float]:
    """The likeliest timer near a fit's, all free parameters adapting, and its fall of chi2.

    Parameters
    ----------
    fit : Fit
        Fit of a recording with a timer.
    estimates : sequence of QuantiserEstimate
        Estimates from the readings of that timer and of similar ones.
    pm_flux_wb : float
        Magnet flux [Wb].

    Raises
    ------
    ValueError
        If the recording has no timer.
    """
    rounding = _Rounding.of(fit, estimates, pm_flux_wb)
    x = rounding.start
    for place in rounding.undetermined_places:
        x = rounding.scanned(x, place)
    for step_ratio in DIFFERENCE_STEPS:
        x = _descended(rounding, x, step_ratio)
    x = _over_jumps(rounding, x)
    return rounding.estimate.moved(x), rounding.cost(rounding.start) - rounding.cost(x)


def _over_jumps(rounding: _Rounding, x: Array) -> Array:
    """Descend from the likeliest neighbouring step, then phases at each PWM frequency, where these are likelier."""
    x = _descended_if_moved(rounding, rounding.scanned_step(x), x)
    for place in rounding.used_places:
        x = _descended_if_moved(rounding, rounding.scanned(x, place, around=SCANNED_NEARBY), x)
    return x


def _descended_if_moved(rounding: _Rounding, moved: Array, x: Array) -> Array:
    return x if moved is x else _descended(rounding, moved, DIFFERENCE_STEPS[-1])


def _descended(rounding: _Rounding, x: Array, step_ratio: float) -> Array:
    """Gauss-Newton descent with Levenberg-Marquardt damping (doi:10.1137/0111030)."""
    cost, damping = rounding.cost(x), 0.0
    for _ in range(MAX_NEWTON_STEPS):
        curvature, slope = rounding.linear(x, step_ratio)
        while True:
            # Phases that no command crosses have no slope: the minimum-norm solution leaves them where they are.
            move = -np.linalg.lstsq(curvature + damping * np.diag(np.diag(curvature)), slope, rcond=1e-12)[0]
            trial = rounding.cost(x + move)
            if trial < cost or damping > MAX_DAMPING:
                break
            damping = max(10.0 * damping, FIRST_DAMPING)
        gain = cost - trial
        if gain <= 0.0:
            break
        x, cost, damping = x + move, trial, 0.1 * damping
        if gain < LEAST_CHI2_GAIN:
            break
    return x


@dataclass(frozen=True)
class _Segment:
    """A training segment with the whitened columns of all adapting parameters."""

    piece: SegmentData
    batch: SegmentBatch
    """The segment as a batch."""
    base: SignalBatch
    whitener: Whitener
    local: LocalMap
    columns: Array
    residual: Array
    added_ab: Array
    """Rounding by the fit's timer [V]."""
    used: Indices
    """Indices in x of the step and of the two phases at its PWM frequency."""

    def added_by(self, timer: ModulatorTimer, bus_v: float) -> Array:
        added = added_by(timer, self.piece, bus_v)
        return np.zeros_like(self.added_ab) if added is None else added

    def rows_of(self, added_ab: Array, pm_flux_wb: float) -> Array:
        """Change of the whitened residual (rows,) by an added voltage (readings, 2)."""
        v_ab = mean_between(added_ab, self.piece.averaged, self.piece.delay_samples)
        rows = change_of_rows(self.batch, self.base, {"v_ab": v_ab}, self.local, pm_flux_wb)
        return self.whitener(rows[:, None])[:, 0]


@dataclass(frozen=True)
class _Rounding:
    """Dependence of a fit's chi2 on the timer.

    Attributes
    ----------
    normal : array
        Normal matrix of R_s, the map and all free parameters, with their priors.
    estimate : QuantiserEstimate
        Estimate with phases at all of the fit's PWM frequencies; x is a timer's difference from it.
    start : array, shape (1 + 2 frequencies,)
        x of the fit's timer.
    unit : array, same shape
        Changes of x that move the largest command by a whole step.
    """

    segments: Sequence[_Segment]
    normal: Array
    estimate: QuantiserEstimate
    start: Array
    unit: Array
    bus_v: float
    pm_flux_wb: float

    @classmethod
    def of(cls, fit: Fit, estimates: Sequence[QuantiserEstimate], pm_flux_wb: float) -> _Rounding:
        timer, bus_v = fit.prepared.quantiser, fit.prepared.manifest.drive.dc_bus_voltage_v
        if timer is None:
            raise ValueError("expected a recording with a modulator's timer")
        pieces = [(k, p) for k, p in enumerate(fit.prepared.pieces) if not p.held_out]
        nearest = min(estimates, key=lambda one: abs(one.timer.step_s / timer.step_s - 1.0))
        nearest = nearest.at([p.pwm_frequency_hz for p in timer.phases])
        place = {p.pwm_frequency_hz: 1 + 2 * k for k, p in enumerate(nearest.timer.phases)}
        segments, max_steps = [], 1.0
        for (k, piece), (linear, columns, residual) in zip(pieces, fit.training(), strict=True):
            added, pwm_hz = added_by(timer, piece, bus_v), piece.signals.pwm_frequency_hz
            if added is not None:
                at = min(place, key=lambda known: abs(known - pwm_hz))
                used = np.array([0, place[at], place[at] + 1])
                batch, base = fit.linearisation.base_of(k)
                local = local_map(batch, fit.corrected(k), fit.model.magnetics)
                whitener = fit.linearisation.pieces[k].whitener
                follows = np.column_stack([linear, columns])
                segments.append(_Segment(piece, batch, base, whitener, local, follows, residual, added, used))
                step_v = leg_step_of(timer.step_s, pwm_hz, bus_v)
                max_steps = max(max_steps, float(np.abs(piece.command_ab).max()) / step_v)
        start = nearest.to(timer)
        unit = np.array([1.0 / max_steps, *[1.0] * (len(start) - 1)])
        return cls(segments, fit.system()[0], nearest, start, unit, bus_v, pm_flux_wb)

    @property
    def undetermined_places(self) -> Sequence[int]:
        """Indices in x of the first phases at PWM frequencies where the readings determine none."""
        known = np.diag(self.estimate.curvature) > 0.0
        return [k for k in range(1, len(known), 2) if known.any() and not known[k : k + 2].any()]

    @property
    def used_places(self) -> Sequence[int]:
        """Indices in x of the first phases at PWM frequencies with a segment that depends on them."""
        return sorted({int(k) for one in self.segments for k in one.used[1:2]})

    def scanned(self, x: Array, place: int, around: int = SCANNED_PHASES) -> Array:
        """x with the likeliest phases at one PWM frequency, all else adapting.

        Tries all phases, or `around` on either side. Each edge contributes half of the rounding, so that both phases
        can be scanned separately.
        """
        phases = self.estimate.moved(x).phases[place // 2]
        if around < SCANNED_PHASES // 2:
            near = np.arange(-around, around + 1) / SCANNED_PHASES
            parts = np.concatenate([phases.rise + near, phases.fall + near])
            rises, falls = np.arange(len(near)), np.arange(len(near), len(parts))
        else:
            parts = np.arange(SCANNED_PHASES) / SCANNED_PHASES
            rises = falls = np.arange(SCANNED_PHASES)
        count = len(parts)
        both = np.tile(x, (count, 1))
        both[:, place : place + 2] += parts[:, None] - [phases.rise, phases.fall]
        timers = [self.estimate.moved(one) for one in both]
        slope, curvature = np.zeros(count), np.zeros((count, count))
        cross = np.zeros((len(self.normal), count))
        for one in self.segments:
            if place in one.used:
                changes = np.stack([self._change(one, timer) for timer in timers], axis=-1)
                slope += changes.T @ one.residual
                curvature += changes.T @ changes
                cross += one.columns.T @ changes
        curvature -= cross.T @ np.linalg.solve(self.normal, cross)
        alone = slope + 0.25 * np.diag(curvature)
        costs = (alone[:, None] + alone + 0.5 * curvature)[np.ix_(rises, falls)]
        rise, fall = np.unravel_index(np.argmin(costs), costs.shape)
        placed = x.copy()
        placed[place : place + 2] = both[rises[rise], place], both[falls[fall], place + 1]
        return placed if self.cost(placed) < self.cost(x) else x

    def scanned_step(self, x: Array) -> Array:
        """x with the likeliest of neighbouring steps, the phases following to first order."""
        curvature, _ = self.linear(x, DIFFERENCE_STEPS[0])
        follow = -np.linalg.lstsq(curvature[1:, 1:], curvature[1:, 0], rcond=1e-12)[0]
        near = np.arange(-SCANNED_NEARBY, SCANNED_NEARBY + 1) / SCANNED_PHASES * self.unit[0]
        return min([x, *(x + part * np.append(1.0, follow) for part in near if part)], key=self.cost)

    def cost(self, x: Array) -> float:
        """Change of chi2 with a timer, all else adapting, including the readings' likelihood."""
        pull, squares = np.zeros(len(self.normal)), 0.0
        timer = self.estimate.moved(x)
        for one in self.segments:
            change = self._change(one, timer)
            pull += one.columns.T @ change
            squares += float(change @ (2.0 * one.residual + change))
        return squares - float(pull @ np.linalg.solve(self.normal, pull)) + float(x @ self.estimate.curvature @ x)

    def linear(self, x: Array, step_ratio: float) -> tuple[Array, Array]:
        """Half the Gauss-Newton curvature of the cost and half its slope, all else adapting."""
        count, width = len(x), len(self.normal)
        squares, cross = np.zeros((count, count)), np.zeros((width, count))
        slope, pull = np.zeros(count), np.zeros(width)
        timer, steps = self.estimate.moved(x), np.diag(step_ratio * self.unit)
        sides = [(self.estimate.moved(x + step), self.estimate.moved(x - step)) for step in steps]
        for one in self.segments:
            change = self._change(one, timer)
            columns = np.stack([self._column(one, *sides[k]) / (2.0 * steps[k, k]) for k in one.used], axis=-1)
            squares[np.ix_(one.used, one.used)] += columns.T @ columns
            cross[:, one.used] += one.columns.T @ columns
            slope[one.used] += columns.T @ (one.residual + change)
            pull += one.columns.T @ change
        follow = np.linalg.solve(self.normal, cross)
        curvature_of_readings = self.estimate.curvature
        curvature = squares - cross.T @ follow + curvature_of_readings
        return curvature, slope - follow.T @ pull + curvature_of_readings @ x

    def _change(self, one: _Segment, timer: ModulatorTimer) -> Array:
        return one.rows_of(one.added_by(timer, self.bus_v) - one.added_ab, self.pm_flux_wb)

    def _column(self, one: _Segment, ahead: ModulatorTimer, behind: ModulatorTimer) -> Array:
        return one.rows_of(one.added_by(ahead, self.bus_v) - one.added_by(behind, self.bus_v), self.pm_flux_wb)
