"""Refined estimate of the modulator's quantiser from the voltages of dwells.

Readings determine a step to 1e-4 and its phases to a few hundredths; a hold's mean voltage is known to microvolts where
the effects' forms are. Quantiser and remaining scatter are estimated alternately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, dwells, leg_step_of, legs_of, rounded_by
from orchestrator.diagnosis.nuisances.segment_scatter import Likelihood, is_same_scatter
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.numerics.types import Array, Indices
from protocols import ModelNoise, ModulatorTimer

SIMPLEX_STEP_CHANGE = 0.1
"""Initial simplex: change of the largest command, in steps."""
PHASES_TRIED = 12
"""Phases of each edge tried before the descent."""
SIMPLEX_PHASE = 0.04
"""Initial simplex: change of a phase, in steps."""
MAX_COMMANDS_PER_DWELL = 400
"""Maximum number of commands used of each dwell."""
MAX_ALTERNATIONS = 6
"""Maximum number of alternations between quantiser and scatter."""


def quantiser_of_dwells(
    prepared: PreparedRecording, likelihood: Likelihood, scatter: ModelNoise, estimate: Sequence[QuantiserEstimate]
) -> tuple[ModulatorTimer, ModelNoise]:
    """The likeliest timer near the estimates from readings, and the scatter beside it.

    Parameters
    ----------
    prepared : PreparedRecording
        Recording with the dwells' commands.
    likelihood : Likelihood
        Likelihood of the same recording with voltages as commanded.
    scatter : ModelNoise
        Initial scatter beside a timer; holds alone do not separate the readings' scatter from the voltages'.
    estimate : sequence of QuantiserEstimate
        One or more estimates.
    """
    if not likelihood.dwells:
        return estimate[0].timer, scatter
    found = list[tuple[float, ModulatorTimer, ModelNoise]]()
    for one in estimate:
        held = _HeldCommands.of(prepared, one.timer.centred)
        known = one.at(np.unique(held.pwm_hz).tolist())
        found.append(_alternate(likelihood, held, known, scatter))
    _, timer, scatter = min(found, key=lambda one: one[0])
    return timer, scatter


def _alternate(
    likelihood: Likelihood, held: _HeldCommands, estimate: QuantiserEstimate, scatter: ModelNoise
) -> tuple[float, ModulatorTimer, ModelNoise]:
    """The most likely timer near an estimate and the scatter, each given the other, after minus twice their log
    likelihood."""
    doubt = 0.0
    x = _scan_phases(held, estimate, *likelihood.held_volts(scatter))
    for _ in range(MAX_ALTERNATIONS):
        x = _minimise(held, estimate, x, *likelihood.held_volts(scatter))
        with_it = likelihood.with_volts(held.rounded_by(estimate.moved(x)))
        doubt = float(x @ estimate.curvature @ x) - 2.0 * estimate.gain
        before, scatter = scatter, with_it.most_likely((True, True), near=scatter)
        if is_same_scatter(before, scatter):
            break
    return with_it.cost(scatter) + doubt, estimate.moved(x), scatter


@dataclass(frozen=True)
class _HeldCommands:
    """The commands of every dwell, in the likelihood's order."""

    commands: Array
    """Commands of all dwells, evenly spread in each (n, 2) [V]."""
    starts: Indices
    """Index of each dwell's first command (dwells,)."""
    mean_v: Array
    """Mean of each leg (dwells, 3)."""
    pwm_hz: Array
    bus_v: float
    centred: bool

    @classmethod
    def of(cls, prepared: PreparedRecording, centred: bool) -> _HeldCommands:
        commands, mean, pwm = list[Array](), list[Array](), list[float]()
        for piece in prepared.pieces:
            if piece.held_out:
                continue
            for dwell in dwells(piece):
                held: Array = piece.command_ab[dwell.start * piece.averaged : dwell.stop * piece.averaged]
                held = held[:: max(1, len(held) // MAX_COMMANDS_PER_DWELL)].copy()
                commands.append(held)
                mean.append(legs_of(held, centred).mean(axis=0))
                pwm.append(piece.signals.pwm_frequency_hz)
        starts = np.concatenate([[0], np.cumsum([len(held) for held in commands])[:-1]])
        bus_v = prepared.manifest.drive.dc_bus_voltage_v
        return cls(np.concatenate(commands), starts, np.array(mean), np.array(pwm), bus_v, centred)

    def rounded_by(self, timer: ModulatorTimer) -> Array:
        """Mean rounding in each dwell (2 dwells,) [V]."""
        out = np.empty((len(self.starts), 2))
        ends = np.append(self.starts[1:], len(self.commands))
        for phases in timer.phases:
            step_v = leg_step_of(timer.step_s, phases.pwm_frequency_hz, self.bus_v)
            for first, last in self.runs(phases.pwm_frequency_hz):
                rows = slice(self.starts[first], ends[last - 1])
                off = rounded_by(self.commands[rows], step_v, phases.rise, phases.fall, centred=self.centred)
                sums = np.add.reduceat(off, self.starts[first:last] - self.starts[first], axis=0)
                out[first:last] = sums / (ends[first:last] - self.starts[first:last])[:, None]
        return out.ravel()

    def runs(self, pwm_hz: float) -> list[tuple[int, int]]:
        """Ranges of consecutive dwells at a PWM frequency."""
        at = np.flatnonzero(np.diff(np.concatenate([[0], self.pwm_hz == pwm_hz, [0]])))
        return list(zip(at[::2].tolist(), at[1::2].tolist(), strict=True))

    def finest(self, step_s: float) -> float:
        """Relative change of the step that changes the largest command by one step."""
        steps = np.abs(self.mean_v) / leg_step_of(step_s, self.pwm_hz, self.bus_v)[:, None]
        return 1.0 / max(float(steps.max()), 1.0)


def _scan_phases(held: _HeldCommands, estimate: QuantiserEstimate, normal: Array, pull: Array) -> Array:
    """The likeliest of the phases tried, for one PWM frequency after the other, in two passes."""
    x = np.zeros(len(estimate.curvature))
    offs = (np.arange(PHASES_TRIED) / PHASES_TRIED + 0.5) % 1.0 - 0.5
    for at in [*range(1, len(x), 2)] * 2:
        tried = [_with_phase(x, at, rise, fall) for rise in offs for fall in offs]
        x = min(tried, key=lambda one: _cost(held, estimate, one, normal, pull))
    return x


def _with_phase(x: Array, at: int, rise: float, fall: float) -> Array:
    placed = x.copy()
    placed[at : at + 2] = rise, fall
    return placed


def _cost(held: _HeldCommands, estimate: QuantiserEstimate, x: Array, normal: Array, pull: Array) -> float:
    """Minus the log likelihood of a timer that differs by x from the readings' estimate, all else adapting."""
    volts = held.rounded_by(estimate.moved(x))
    return 0.5 * float(x @ estimate.curvature @ x) + float(volts @ pull + 0.5 * volts @ normal @ volts)


def _minimise(held: _HeldCommands, estimate: QuantiserEstimate, start: Array, normal: Array, pull: Array) -> Array:
    """x of the likeliest timer near `start`, including the readings' likelihood."""
    from scipy.optimize import minimize

    # Within the initial simplex the largest command moves by a fraction of a step.
    size = np.array([SIMPLEX_STEP_CHANGE * held.finest(estimate.timer.step_s), *[SIMPLEX_PHASE] * (len(start) - 1)])
    simplex = np.concatenate([start[None], start + np.diag(size)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-5, "fatol": 0.05, "maxfev": 100 * len(start)}

    def cost(x: Array) -> float:
        return _cost(held, estimate, x, normal, pull)

    return np.asarray(minimize(cost, start, method="Nelder-Mead", options=options).x, dtype=np.float64)
