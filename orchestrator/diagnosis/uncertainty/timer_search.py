"""Whether what is off in held voltages is a modulator's timer, and which: its step, and where its steps lie.

What looks like chance repeats at the same command. The likelihood has a peak for every step that meets a few rests, and
the true one stands out: thousands are tried by the first harmonic of the rounding's saw, each rest's weakened by what
trembles in it, and the best are then told by the rounding itself, command by command, with its own amplitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from orchestrator.diagnosis.uncertainty.scatter import Likelihood, as_much
from orchestrator.diagnosis.weak_form.rests import rests
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.diagnosis.weak_form.timer import leg_step_of, legs_of, rounded_by
from orchestrator.numerics.frames import from_phases
from orchestrator.numerics.types import Array, Indices
from protocols import ModelNoise, ModulatorTimer, TimerPhases

FINEST = 0.1
"""Of a step: by how much the largest command may miss it from one step that is tried to the next."""
MOST_STEPS = 20_000
"""That are tried, whatever the bus."""
MOST_COMMANDS = 400
"""Of each rest: they tremble alike all through."""
PARTS = 12
"""Of a step, of either edge, that are tried before the descent."""
SAME = 0.25
"""Of a step, by which two commands may differ and be off by much the same."""
HALF = 0.5
"""Of what the best gains so: what gains less is no rival."""
BEST = 4
"""Steps that are told by the rounding itself."""
SHARPENINGS = 6
"""How often timer and scatter are told, each in the light of the other."""


def timer_of(
    prepared: PreparedRecording,
    likelihood: Likelihood,
    scatter: ModelNoise | None = None,
    known: ModulatorTimer | None = None,
) -> tuple[ModulatorTimer, ModelNoise] | None:
    """The timer whose rounding is what scatters in held voltages, and what still does; None where there is no timer.

    Parameters
    ----------
    prepared : PreparedRecording
        Whose commands the rests' are.
    likelihood : Likelihood
        Of the same recording with its voltages as they were commanded.
    scatter : ModelNoise, optional
        What there is beside `known`, or without any timer: where it is looked for from on. In holds alone it may be
        told as the readings' as well as as the voltages'.
    known : ModulatorTimer, optional
        As an earlier fit told it: it is looked for in its neighbourhood alone, and is there.
    """
    if not likelihood.rests or (scatter is not None and not scatter.scatters):
        return None
    if known is not None and scatter is not None:
        told = _sharpened(likelihood, _HeldCommands.of(prepared, known.centred), known, scatter)
        return told.timer, told.scatter
    scatter = likelihood.likeliest((True, True), dithered=False, near=scatter)
    promising, tried = _promising(prepared, *likelihood.held_volts(scatter))
    found = list[_Sharpened]()
    for one in promising:
        told = _sharpened(likelihood, one.held, one.timer, scatter)
        asked = (likelihood.criteria.selection.log_evidence + math.log(tried)) * one.held.repeated(told.timer)
        if likelihood.cost(scatter) - told.cost > 2.0 * asked:
            found.append(told)
    best = min(found, key=lambda told: told.cost, default=None)
    return None if best is None else (best.timer, best.scatter)


def _promising(prepared: PreparedRecording, normal: Array, pull: Array) -> tuple[list[_Promising], int]:
    """Those timers that gain most, with the scatter as large as without, and how many were tried."""
    limits, tried, found = prepared.criteria.uncertainty, 0, list[_Promising]()
    for centred in (True, False):
        held = _HeldCommands.of(prepared, centred)
        steps = held.candidates(limits.least_timer_step_s, limits.most_timer_step_s)
        tried += len(steps)
        gains = np.array([_gain(held.harmonic(step), normal, pull) for step in steps])
        found += [_with_phases(held, float(steps[k]), normal, pull) for k in _highest(gains)]
    best = sorted(found, key=lambda one: -one.gain)[:BEST]
    return [one for one in best if one.gain > HALF * best[0].gain], tried


def _sharpened(likelihood: Likelihood, held: _HeldCommands, timer: ModulatorTimer, scatter: ModelNoise) -> _Sharpened:
    """The likeliest timer near one and the scatter beside it, each told in the light of the other."""
    for _ in range(SHARPENINGS):
        timer = _near(held, timer, *likelihood.held_volts(scatter))
        with_it = likelihood.with_volts(held.rounded_by(timer))
        before, scatter = scatter, with_it.likeliest((True, True), dithered=False, near=scatter)
        if as_much(before, scatter):
            break
    return _Sharpened(timer, scatter, with_it.cost(scatter))


def _highest(gains: Array) -> list[int]:
    """Where the highest peaks are."""
    beside = np.maximum(np.append(gains[1:], -np.inf), np.append(-np.inf, gains[:-1]))
    return [int(k) for k in np.argsort(np.where(gains >= beside, gains, -np.inf))[: -1 - BEST : -1]]


def _gain(columns: Array, normal: Array, pull: Array) -> float:
    """What columns in held volts gain in log likelihood, to first order."""
    inside = columns.T @ normal @ columns
    towards = columns.T @ pull
    ridge = 1e-9 * max(float(np.trace(inside)), np.finfo(np.float64).tiny)
    return 0.5 * float(towards @ np.linalg.solve(inside + ridge * np.eye(len(inside)), towards))


@dataclass(frozen=True)
class _HeldCommands:
    """The commands of every rest, in the order of what the likelihood says of their volts."""

    commands: Array
    """Of all rests, evenly spread in each (n, 2) [V]."""
    starts: Indices
    """Where each rest's begin (rests,)."""
    mean_v: Array
    """Of its legs (rests, 3)."""
    trembling_v: Array
    """rms around that (rests, 3)."""
    pwm_hz: Array
    bus_v: float
    centred: bool

    @classmethod
    def of(cls, prepared: PreparedRecording, centred: bool) -> _HeldCommands:
        commands, mean, trembling, pwm = list[Array](), list[Array](), list[Array](), list[float]()
        for piece in prepared.pieces:
            if piece.held_out:
                continue
            for rest in rests(piece):
                held: Array = piece.command_ab[rest.start * piece.averaged : rest.stop * piece.averaged]
                held = held[:: max(1, len(held) // MOST_COMMANDS)].copy()
                legs = legs_of(held, centred)
                commands.append(held)
                mean.append(legs.mean(axis=0))
                trembling.append(legs.std(axis=0))
                pwm.append(piece.signals.pwm_frequency_hz)
        starts = np.concatenate([[0], np.cumsum([len(held) for held in commands])[:-1]])
        spread, bus_v = np.array(trembling), prepared.manifest.drive.dc_bus_voltage_v
        return cls(np.concatenate(commands), starts, np.array(mean), spread, np.array(pwm), bus_v, centred)

    def candidates(self, least_s: float, most_s: float) -> Array:
        """Steps so near to each other that the saw of the largest command is not missed."""
        reach = float((np.abs(self.mean_v) / self.pwm_hz[:, None]).max())
        apart = FINEST * 2.0 * self.bus_v / reach if reach > 0.0 else 1.0 / least_s
        apart = max(apart, (1.0 / least_s - 1.0 / most_s) / MOST_STEPS)
        # The saw's phase is the command over the step: evenly spread over one over the step.
        return np.asarray(1.0 / np.arange(1.0 / most_s, 1.0 / least_s, apart), dtype=np.float64)

    def harmonic(self, step_s: float) -> Array:
        """First harmonic of the rounding, sine and cosine for each PWM frequency, shape (2 rests, 2 frequencies)."""
        step_v = leg_step_of(step_s, self.pwm_hz, self.bus_v)[:, None]
        angle = 2.0 * np.pi * self.mean_v / step_v
        size = step_v / np.pi * np.exp(-2.0 * (np.pi * self.trembling_v / step_v) ** 2)
        columns = []
        for frequency in np.unique(self.pwm_hz):
            there = (self.pwm_hz == frequency)[:, None]
            for wave in np.sin(angle), np.cos(angle):
                columns.append(from_phases(there * size * wave).ravel())
        return np.stack(columns, axis=1)

    def rounded_by(self, timer: ModulatorTimer) -> Array:
        """Mean of what the rounding adds in each rest (2 rests,)."""
        out = np.empty((len(self.starts), 2))
        ends = np.append(self.starts[1:], len(self.commands))
        for phases in timer.phases:
            step_v = leg_step_of(timer.step_s, phases.pwm_frequency_hz, self.bus_v)
            for first, last in self.runs(phases.pwm_frequency_hz):
                there = slice(self.starts[first], ends[last - 1])
                off = rounded_by(self.commands[there], step_v, phases.rise, phases.fall, centred=self.centred)
                sums = np.add.reduceat(off, self.starts[first:last] - self.starts[first], axis=0)
                out[first:last] = sums / (ends[first:last] - self.starts[first:last])[:, None]
        return out.ravel()

    def runs(self, pwm_hz: float) -> list[tuple[int, int]]:
        """Rests in a row at a PWM frequency, from the first on to before the last."""
        at = np.flatnonzero(np.diff(np.concatenate([[0], self.pwm_hz == pwm_hz, [0]])))
        return list(zip(at[::2].tolist(), at[1::2].tolist(), strict=True))

    def repeated(self, timer: ModulatorTimer) -> float:
        """How many rests there are of each command, or of its opposite.

        Whatever a form leaves there is the same in all of them: only one of them bears witness.
        """
        steps = self.mean_v / leg_step_of(timer.step_s, self.pwm_hz, self.bus_v)[:, None]
        different = list[int]()
        for k, legs in enumerate(steps):
            there = [j for j in different if self.pwm_hz[j] == self.pwm_hz[k]]
            apart = [min(np.abs(steps[j] - legs).max(), np.abs(steps[j] + legs).max()) for j in there]
            if min(apart, default=np.inf) > SAME:
                different.append(k)
        return len(steps) / len(different)

    def finest(self, step_s: float) -> float:
        """Part of a step by which the largest command is one step more."""
        steps = np.abs(self.mean_v) / leg_step_of(step_s, self.pwm_hz, self.bus_v)[:, None]
        return 1.0 / max(float(steps.max()), 1.0)


@dataclass(frozen=True)
class _Promising:
    """A timer, and what it gains in log likelihood."""

    held: _HeldCommands
    timer: ModulatorTimer
    gain: float


@dataclass(frozen=True)
class _Sharpened:
    """A timer, what scatters beside it, and minus twice the log likelihood of both."""

    timer: ModulatorTimer
    scatter: ModelNoise
    cost: float


def _gained(volts: Array, normal: Array, pull: Array) -> float:
    """What volts in the rests gain in log likelihood, everything else following."""
    return -float(volts @ pull + 0.5 * volts @ normal @ volts)


def _with_phases(held: _HeldCommands, step_s: float, normal: Array, pull: Array) -> _Promising:
    """The likeliest phases of a step, of those that are tried: for one PWM frequency after the other, twice."""
    frequencies = np.unique(held.pwm_hz).tolist()
    phases = {pwm_hz: TimerPhases(pwm_frequency_hz=pwm_hz, rise=0.0, fall=0.0) for pwm_hz in frequencies}
    told = list[_Promising]()
    for pwm_hz in frequencies * 2:
        told = []
        for rise, fall in combinations_with_replacement(range(PARTS), 2):
            phases[pwm_hz] = TimerPhases(pwm_frequency_hz=pwm_hz, rise=rise / PARTS, fall=fall / PARTS)
            timer = ModulatorTimer(step_s=step_s, centred=held.centred, phases=tuple(phases.values()))
            told.append(_Promising(held, timer, _gained(held.rounded_by(timer), normal, pull)))
        best = max(told, key=lambda one: one.gain)
        phases = {p.pwm_frequency_hz: p for p in best.timer.phases}
    return max(told, key=lambda one: one.gain)


def _near(held: _HeldCommands, timer: ModulatorTimer, normal: Array, pull: Array) -> ModulatorTimer:
    """The likeliest timer in the neighbourhood of one."""
    from scipy.optimize import minimize

    def there(x: Array) -> ModulatorTimer:
        parts = np.mod(x[1:], 1.0).reshape(-1, 2).tolist()
        moved = [p.model_copy(update={"rise": r, "fall": f}) for p, (r, f) in zip(timer.phases, parts, strict=True)]
        return timer.model_copy(update={"step_s": timer.step_s * (1.0 + float(x[0])), "phases": tuple(moved)})

    def cost(x: Array) -> float:
        return -_gained(held.rounded_by(there(x)), normal, pull)

    start = np.array([0.0, *(part for p in timer.phases for part in (p.rise, p.fall))])
    # Across the simplex the largest command moves by no more than a part of a step.
    size = np.array([FINEST * held.finest(timer.step_s), *[0.5 / PARTS] * (len(start) - 1)])
    simplex = np.concatenate([start[None], start + np.diag(size)])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-5, "fatol": 0.05, "maxfev": 100 * len(start)},
    )
    return there(np.asarray(found.x))
