"""A modulator's timer estimated beside a whole model: by every equation, where all effects' forms are much as they are.

Dwells show it first, while forms are still wrong (`quantiser_in_dwells`). Then all that holds, sweeps and ripples has
its say. What a timer's rounding changes in the equations is known exactly; R_s, the map and all free parameters follow
to first order (variable projection; G. Golub, V. Pereyra, doi:10.1137/0710036). With g the change of the whitened
residual e, X the columns of what follows, N their normal matrix and C the readings' own say of x,

    cost(x) = 2 e^T g + g^T g - (X^T g)^T N^-1 (X^T g) + x^T C x
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, added_by, leg_step_of
from orchestrator.diagnosis.nuisances.quantiser_counter import counter_models
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import LocalMap, change_of_rows, local_map
from orchestrator.diagnosis.weak_form.noise import Whitener
from orchestrator.diagnosis.weak_form.segments import SegmentData, mean_between
from orchestrator.numerics.types import Array, Indices
from protocols import ModulatorTimer, SignalBatch

DIFFERENCE_STEPS = (0.02, 0.004)
"""Of a step, at the largest command: how far apart differences are taken, one descent after the other.

A hold's command that stands where it jumps by a step hides what lies beyond; far apart, differences see over it.
"""
SCANNED_PHASES = 96
"""Phases that are tried at a PWM frequency at which the readings show none: a rest's command jumps that closely."""
SCANNED_NEARBY = 6
"""Of these, on either side of where a descent ended: beyond a command's jump it may be lower still."""
MAX_NEWTON_STEPS = 12
"""At most, of Gauss and Newton."""
LEAST_CHI2_GAIN = 1.0
"""Gain of a step, in chi2, below which the descent ends."""
FIRST_DAMPING = 0.1
MAX_DAMPING = 1e3


def quantiser_beside(fit: Fit, borne: Sequence[QuantiserEstimate], pm_flux_wb: float) -> tuple[ModulatorTimer, float]:
    """The likeliest timer near a fit's own, all that is free following, and what it takes of chi2.

    Parameters
    ----------
    fit : Fit
        Of a recording with a timer.
    borne : sequence of QuantiserEstimate
        What the readings say of that timer, and of those that round much like it.
    pm_flux_wb : float
        Magnet flux [Wb].

    Raises
    ------
    ValueError
        The fit is of a recording without a timer.
    """
    rounding = _Rounding.of(fit, borne, pm_flux_wb)
    x = rounding.start
    for place in rounding.unknown_places:
        x = rounding.scanned(x, place)
    for apart in DIFFERENCE_STEPS:
        x = _descended(rounding, x, apart)
    x = _over_jumps(rounding, x)
    x = _or_counting(rounding, x, 2.0 * fit.criteria.selection.log_evidence * fit.chi2_per_dof)
    return rounding.borne.moved(x), rounding.cost(rounding.start) - rounding.cost(x)


def _over_jumps(rounding: _Rounding, x: Array) -> Array:
    """Where descents from the likeliest phases around lead, at each PWM frequency where these are likelier."""
    for place in rounding.known_places:
        moved = rounding.scanned(x, place, around=SCANNED_NEARBY)
        x = x if moved is x else _descended(rounding, moved, DIFFERENCE_STEPS[-1])
    return x


def _or_counting(rounding: _Rounding, x: Array, evidence: float) -> Array:
    """The likeliest timer that counts from the carrier's turns, unless `x` is likelier by so much chi2."""
    families = [*counter_models(rounding.borne, rounding.start), *counter_models(rounding.borne, x)]
    best = min((one.likeliest(rounding.cost) for one in families), key=rounding.cost, default=x)
    return best if rounding.cost(best) < rounding.cost(x) + evidence else x


def _descended(rounding: _Rounding, x: Array, apart: float) -> Array:
    """Where Gauss and Newton lead, damped as by Levenberg and Marquardt (doi:10.1137/0111030)."""
    cost, damping = rounding.cost(x), 0.0
    for _ in range(MAX_NEWTON_STEPS):
        curvature, slope = rounding.linear(x, apart)
        while True:
            # A phase that no command meets within a difference changes nothing: a shift of all legs is none.
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
    """A training segment: what its rows are made of, and the whitened columns of all that follows."""

    piece: SegmentData
    batch: SegmentBatch
    """The segment alone."""
    base: SignalBatch
    whitener: Whitener
    local: LocalMap
    columns: Array
    residual: Array
    added_ab: Array
    """By the fit's own timer [V]."""
    used: Indices
    """Which of a timer's numbers matter at its PWM frequency: the step, and two phases."""

    def added_by(self, timer: ModulatorTimer, bus_v: float) -> Array:
        added = added_by(timer, self.piece, bus_v)
        return np.zeros_like(self.added_ab) if added is None else added

    def rows_of(self, added_ab: Array, pm_flux_wb: float) -> Array:
        """What an added voltage (readings, 2) changes of the whitened residual (rows,)."""
        v_ab = mean_between(added_ab, self.piece.averaged, self.piece.delay_samples)
        rows = change_of_rows(self.batch, self.base, {"v_ab": v_ab}, self.local, pm_flux_wb)
        return self.whitener(rows[:, None])[:, 0]


@dataclass(frozen=True)
class _Rounding:
    """What a change of the timer does to a fit's equations.

    Attributes
    ----------
    normal : array
        Of R_s, the map and all free parameters, with their priors.
    borne : QuantiserEstimate
        Known wherever the fit's own is; x is how much a timer differs from it.
    start : array, shape (1 + 2 frequencies,)
        x of the fit's own timer.
    unit : array, same shape
        What moves the largest command by a whole step.
    """

    segments: Sequence[_Segment]
    normal: Array
    borne: QuantiserEstimate
    start: Array
    unit: Array
    bus_v: float
    pm_flux_wb: float

    @classmethod
    def of(cls, fit: Fit, borne: Sequence[QuantiserEstimate], pm_flux_wb: float) -> _Rounding:
        timer, bus_v = fit.prepared.quantiser, fit.prepared.manifest.drive.dc_bus_voltage_v
        if timer is None:
            raise ValueError("expected a recording with a modulator's timer")
        pieces = [(k, p) for k, p in enumerate(fit.prepared.pieces) if not p.held_out]
        nearest = min(borne, key=lambda one: abs(one.timer.step_s / timer.step_s - 1.0))
        nearest = nearest.at([p.pwm_frequency_hz for p in timer.phases])
        place = {p.pwm_frequency_hz: 1 + 2 * k for k, p in enumerate(nearest.timer.phases)}
        segments, most = [], 1.0
        for (k, piece), (linear, columns, residual) in zip(pieces, fit.training(), strict=True):
            added, pwm_hz = added_by(timer, piece, bus_v), piece.signals.pwm_frequency_hz
            if added is not None:
                at = min(place, key=lambda known: abs(known - pwm_hz))
                used = np.array([0, place[at], place[at] + 1])
                batch, base = fit.frame.base_of(k)
                local = local_map(batch, fit.corrected(k), fit.model.magnetics)
                whitener = fit.frame.pieces[k].whitener
                follows = np.column_stack([linear, columns])
                segments.append(_Segment(piece, batch, base, whitener, local, follows, residual, added, used))
                most = max(most, float(np.abs(piece.command_ab).max()) / leg_step_of(timer.step_s, pwm_hz, bus_v))
        start = nearest.to(timer)
        unit = np.array([1.0 / most, *[1.0] * (len(start) - 1)])
        return cls(segments, fit.system()[0], nearest, start, unit, bus_v, pm_flux_wb)

    @property
    def unknown_places(self) -> Sequence[int]:
        """Where in x the phases begin of those PWM frequencies at which the readings show none."""
        known = np.diag(self.borne.curvature) > 0.0
        return [k for k in range(1, len(known), 2) if known.any() and not known[k : k + 2].any()]

    @property
    def known_places(self) -> Sequence[int]:
        """Where in x the phases begin of those PWM frequencies at which a segment depends on them."""
        return sorted({int(k) for one in self.segments for k in one.used[1:2]})

    def scanned(self, x: Array, place: int, around: int = SCANNED_PHASES) -> Array:
        """x with the likeliest phases at one PWM frequency, all else following: of all, or of so many to either side.

        Either edge has half a say in what is added, so that two phases need no more to be tried than one.
        """
        own = self.borne.moved(x).phases[place // 2]
        if around < SCANNED_PHASES // 2:
            near = np.arange(-around, around + 1) / SCANNED_PHASES
            parts = np.concatenate([own.rise + near, own.fall + near])
            rises, falls = np.arange(len(near)), np.arange(len(near), len(parts))
        else:
            parts = np.arange(SCANNED_PHASES) / SCANNED_PHASES
            rises = falls = np.arange(SCANNED_PHASES)
        count = len(parts)
        both = np.tile(x, (count, 1))
        both[:, place : place + 2] += parts[:, None] - [own.rise, own.fall]
        timers = [self.borne.moved(one) for one in both]
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

    def cost(self, x: Array) -> float:
        """By how much chi2 changes with a timer, all else following, and the readings' say."""
        pull, squares = np.zeros(len(self.normal)), 0.0
        timer = self.borne.moved(x)
        for one in self.segments:
            change = self._change(one, timer)
            pull += one.columns.T @ change
            squares += float(change @ (2.0 * one.residual + change))
        return squares - float(pull @ np.linalg.solve(self.normal, pull)) + float(x @ self.borne.curvature @ x)

    def linear(self, x: Array, apart: float) -> tuple[Array, Array]:
        """Half the cost's curvature, as of Gauss and Newton, and half its slope, all else following."""
        count, width = len(x), len(self.normal)
        squares, cross = np.zeros((count, count)), np.zeros((width, count))
        slope, pull = np.zeros(count), np.zeros(width)
        timer, steps = self.borne.moved(x), np.diag(apart * self.unit)
        sides = [(self.borne.moved(x + step), self.borne.moved(x - step)) for step in steps]
        for one in self.segments:
            change = self._change(one, timer)
            columns = np.stack([self._column(one, *sides[k]) / (2.0 * steps[k, k]) for k in one.used], axis=-1)
            squares[np.ix_(one.used, one.used)] += columns.T @ columns
            cross[:, one.used] += one.columns.T @ columns
            slope[one.used] += columns.T @ (one.residual + change)
            pull += one.columns.T @ change
        follow = np.linalg.solve(self.normal, cross)
        say = self.borne.curvature
        return squares - cross.T @ follow + say, slope - follow.T @ pull + say @ x

    def _change(self, one: _Segment, timer: ModulatorTimer) -> Array:
        return one.rows_of(one.added_by(timer, self.bus_v) - one.added_ab, self.pm_flux_wb)

    def _column(self, one: _Segment, ahead: ModulatorTimer, behind: ModulatorTimer) -> Array:
        return one.rows_of(one.added_by(ahead, self.bus_v) - one.added_by(behind, self.bus_v), self.pm_flux_wb)
