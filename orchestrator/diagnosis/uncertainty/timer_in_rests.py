"""A modulator's timer told more sharply, by what currents at rest say of the voltages that hold them.

Readings tell a step to a ten-thousandth of itself, and its phases to some hundredths; a hold's mean voltage is known to
microvolts where the forms of all effects are. Timer and what still scatters are told in turn, each in the light of the
other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from orchestrator.diagnosis.uncertainty.scatter import Likelihood, as_much
from orchestrator.diagnosis.uncertainty.timer_counting import CountingTimer, counting
from orchestrator.diagnosis.weak_form.rests import rests
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.diagnosis.weak_form.timer import BorneTimer, leg_step_of, legs_of, rounded_by
from orchestrator.numerics.types import Array, Indices
from protocols import ModelNoise, ModulatorTimer

NEAR = 0.1
"""Of a step: by how much the largest command may miss it where a search begins."""
PARTS = 12
"""Of a step, of either edge, that are tried before the descent."""
PHASE = 0.04
"""Of a step, by which a phase may be off where a search begins."""
MOST_COMMANDS = 400
"""Of each rest: they tremble alike all through."""
SHARPENINGS = 6
"""How often timer and scatter are told, each in the light of the other."""


def timer_near(
    prepared: PreparedRecording, likelihood: Likelihood, scatter: ModelNoise, borne: Sequence[BorneTimer]
) -> tuple[ModulatorTimer, ModelNoise]:
    """The likeliest timer in the neighbourhood of those that the readings bear, and what scatters beside it.

    Parameters
    ----------
    prepared : PreparedRecording
        Whose commands the rests' are.
    likelihood : Likelihood
        Of the same recording with its voltages as they were commanded.
    scatter : ModelNoise
        Beside a timer. In holds alone it may be told as the readings' as well as as the voltages'.
    borne : sequence of BorneTimer
        One or more.
    """
    if not likelihood.rests:
        return borne[0].timer, scatter
    told, counted = list[_Sharpened](), list[_Sharpened]()
    for one in borne:
        held = _HeldCommands.of(prepared, one.timer.centred)
        known = one.at(np.unique(held.pwm_hz).tolist())
        told.append(_sharpened(likelihood, held, known, scatter))
        counted += [
            _sharpened(likelihood, held, known, scatter, family) for family in counting(known, known.to(known.timer))
        ]
    best = min(told, key=lambda one: one.cost)
    # That a timer counts from the carrier's turns needs no evidence, that it does not does.
    evidence = 2.0 * prepared.criteria.selection.log_evidence
    best = min([one for one in counted if one.cost < best.cost + evidence], key=lambda one: one.cost, default=best)
    return best.timer, best.scatter


def _sharpened(
    likelihood: Likelihood,
    held: _HeldCommands,
    borne: BorneTimer,
    scatter: ModelNoise,
    family: CountingTimer | None = None,
) -> _Sharpened:
    """The likeliest timer near one, or of a family, and the scatter beside it, each told in the light of the other."""
    doubt = 0.0
    x = _with_phases(held, borne, *likelihood.held_volts(scatter)) if family is None else family.at(0.0)
    for _ in range(SHARPENINGS):
        normal, pull = likelihood.held_volts(scatter)
        if family is None:
            x = _near(held, borne, x, normal, pull)
        else:
            x = family.likeliest(partial(_cost, held, borne, normal=normal, pull=pull))
        with_it = likelihood.with_volts(held.rounded_by(borne.moved(x)))
        doubt = float(x @ borne.curvature @ x) - 2.0 * borne.gain
        before, scatter = scatter, with_it.likeliest((True, True), dithered=False, near=scatter)
        if as_much(before, scatter):
            break
    return _Sharpened(borne.moved(x), scatter, with_it.cost(scatter) + doubt)


@dataclass(frozen=True)
class _HeldCommands:
    """The commands of every rest, in the order of what the likelihood says of their volts."""

    commands: Array
    """Of all rests, evenly spread in each (n, 2) [V]."""
    starts: Indices
    """Where each rest's begin (rests,)."""
    mean_v: Array
    """Of its legs (rests, 3)."""
    pwm_hz: Array
    bus_v: float
    centred: bool

    @classmethod
    def of(cls, prepared: PreparedRecording, centred: bool) -> _HeldCommands:
        commands, mean, pwm = list[Array](), list[Array](), list[float]()
        for piece in prepared.pieces:
            if piece.held_out:
                continue
            for rest in rests(piece):
                held: Array = piece.command_ab[rest.start * piece.averaged : rest.stop * piece.averaged]
                held = held[:: max(1, len(held) // MOST_COMMANDS)].copy()
                commands.append(held)
                mean.append(legs_of(held, centred).mean(axis=0))
                pwm.append(piece.signals.pwm_frequency_hz)
        starts = np.concatenate([[0], np.cumsum([len(held) for held in commands])[:-1]])
        bus_v = prepared.manifest.drive.dc_bus_voltage_v
        return cls(np.concatenate(commands), starts, np.array(mean), np.array(pwm), bus_v, centred)

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

    def finest(self, step_s: float) -> float:
        """Part of a step by which the largest command is one step more."""
        steps = np.abs(self.mean_v) / leg_step_of(step_s, self.pwm_hz, self.bus_v)[:, None]
        return 1.0 / max(float(steps.max()), 1.0)


@dataclass(frozen=True)
class _Sharpened:
    """A timer, what scatters beside it, and minus twice the log likelihood of both."""

    timer: ModulatorTimer
    scatter: ModelNoise
    cost: float


def _gained(volts: Array, normal: Array, pull: Array) -> float:
    """What volts in the rests gain in log likelihood, everything else following."""
    return -float(volts @ pull + 0.5 * volts @ normal @ volts)


def _with_phases(held: _HeldCommands, borne: BorneTimer, normal: Array, pull: Array) -> Array:
    """The likeliest phases of those that are tried, for one PWM frequency after the other, twice."""
    x = np.zeros(len(borne.curvature))
    offs = (np.arange(PARTS) / PARTS + 0.5) % 1.0 - 0.5
    for at in [*range(1, len(x), 2)] * 2:
        tried = [_placed(x, at, rise, fall) for rise in offs for fall in offs]
        x = min(tried, key=lambda one: _cost(held, borne, one, normal, pull))
    return x


def _placed(x: Array, at: int, rise: float, fall: float) -> Array:
    placed = x.copy()
    placed[at : at + 2] = rise, fall
    return placed


def _cost(held: _HeldCommands, borne: BorneTimer, x: Array, normal: Array, pull: Array) -> float:
    """Minus the log likelihood of a timer that differs so from the readings' own."""
    return 0.5 * float(x @ borne.curvature @ x) - _gained(held.rounded_by(borne.moved(x)), normal, pull)


def _near(held: _HeldCommands, borne: BorneTimer, start: Array, normal: Array, pull: Array) -> Array:
    """How the likeliest timer near `start` differs from the readings', which have their say."""
    from scipy.optimize import minimize

    # Across the simplex the largest command moves by no more than a part of a step.
    size = np.array([NEAR * held.finest(borne.timer.step_s), *[PHASE] * (len(start) - 1)])
    simplex = np.concatenate([start[None], start + np.diag(size)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-5, "fatol": 0.05, "maxfev": 100 * len(start)}

    def cost(x: Array) -> float:
        return _cost(held, borne, x, normal, pull)

    return np.asarray(minimize(cost, start, method="Nelder-Mead", options=options).x, dtype=np.float64)
