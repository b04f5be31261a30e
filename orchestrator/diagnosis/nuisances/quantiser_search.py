"""Whether readings bear a modulator's timer, and which: its step, and where its steps lie. Asks no model.

Over a tenth of a second a machine at rest is linear: the next reading is a combination of the last readings and
commands, whatever it saturates, heats or loses. What such a combination, fitted block by block, leaves of the current
is noise, and what the rounding of the last commands moved. Rounding is a function of the command alone: gathered by
command, what is left has a line in its Fourier transform where the frequency is one over the timer's step, and of that
line's harmonics give the two phases. Every part of a recording and every leg has to show it: a pattern that one
sweep, injection or phase happens to make is none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from orchestrator.diagnosis.nuisances.command_traces import LEAST_TIMER_STEP_S, LINEAR_STRETCH_READINGS, CommandTrace
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, leg_step_of, legs_of, legs_rounded_by
from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import ModulatorTimer, TimerPhases

MAX_TIMER_STEP_S: float = 3.5e-8
"""Step of a modulator's timer that scatters held voltages and counts as noise [s]: timers of drives run at 30 MHz and
more."""

FREQUENCY_SPACING_LINEWIDTHS = 0.1
"""Of a line's width, from one step that is tried to the next."""
ZERO_PADDING_FACTOR = 8
"""Lines in a Fourier transform, over those of the commands' own span."""
COMMAND_STRIDE = 10
"""Every so many-th command shows how much commands move."""
BACKGROUND_HALF_WIDTH = 400
"""Steps on either side of one that tell what chance, and everything that is no timer, comes to there."""
PEAKS_REFINED = 4
"""Lines that are refined with the sawtooth itself."""
SAWTOOTH_HARMONICS = 4
"""Of the saw: sixteen parts in seventeen of its power."""
PHASES_PER_STEP = 32
"""Phases within a step that are tried for either edge."""
LEAST_GAIN_RATIO_TO_BEST = 0.5
"""Of what the likeliest gains: what gains less is no rival."""
SAME_STEP_TOLERANCE = 1e-3
"""Of a step: what differs by less is one."""
PHASE_BIAS_STD = 0.06
"""Of a step: by how much readings may tell phases wrongly beside chance. On a practice recording of another plant one
phase of both edges was estimated as two, 0.02 below and 0.14 above it, where chance is below 0.01."""
BLOCK_READINGS = 300
"""Readings that are one witness: longer than a machine remembers a command."""


def detect_quantisation(traces: Sequence[CommandTrace], bus_v: float, least: float) -> tuple[QuantiserEstimate, ...]:
    """The timer that readings bear, and those that round much like it, the likeliest first; none where they bear none.

    Parameters
    ----------
    traces : sequence of CommandTrace
    bus_v : float
        The nominal bus voltage that pulses are made for [V].
    least : float
        Evidence required of one step, by the line and by the blocks; that of all steps that are tried
        comes on top for the line [nat].
    """
    if not traces:
        return ()
    found = list[tuple[float, QuantiserEstimate]]()
    for centred in (True, False):
        combs = _harmonic_sums(traces, centred, bus_v)
        frequency, gain = _spectrum(combs)
        chance = np.maximum(_background(gain, len(combs)), 1.0)
        threshold = least + math.log(2 * len(frequency))
        for k in _highest(gain / chance):
            # Where the two phases are half a step apart, the first harmonic is none.
            for tried in (frequency[k], 0.5 * frequency[k]):
                if tried < frequency[0]:
                    continue
                timer, likelier = _refine_line(combs, centred, float(tried), float(frequency[1] - frequency[0]))
                if likelier > threshold * chance[k] and (witnessed := _block_consistency(traces, timer, bus_v)) > least:
                    estimate = _refine_estimate(combs, timer, likelier, min(likelier / float(chance[k]), witnessed))
                    found.append((likelier, estimate))
    return _most_certain(found)


def _most_certain(found: Sequence[tuple[float, QuantiserEstimate]]) -> tuple[QuantiserEstimate, ...]:
    """The likeliest of those that are about as certain, and what comes near it, each once.

    Witnesses are few: they tell that there is a timer, and hardly which; the readings' likelihood tells that.
    """
    certain = max((estimate.gain for _, estimate in found), default=0.0)
    best = list[QuantiserEstimate]()
    for _, one in sorted(found, key=lambda one: -one[0]):
        if one.gain > LEAST_GAIN_RATIO_TO_BEST * certain and not any(_same(one.timer, other.timer) for other in best):
            best.append(one)
    return tuple(best)


def _same(one: ModulatorTimer, other: ModulatorTimer) -> bool:
    return one.centred == other.centred and math.isclose(one.step_s, other.step_s, rel_tol=SAME_STEP_TOLERANCE)


@dataclass(frozen=True)
class _HarmonicSums:
    """What the readings at one PWM frequency say of the legs' volts, by the legs' commands.

    Attributes
    ----------
    pull : array, shape (n,)
        Gradient of the log likelihood by a leg's volts, summed over commands of about the same pulse width [1/V].
    apart_s : float
        From one width to the next; the first is none, those of the second half are below it.
    widths_s : sequence of array, shape (readings, 3)
        Of each block.
    information : array, shape (blocks,)
        About the volts of a leg, summed over all legs' commands [1/V^2].
    volts_per_s : float
        A leg's mean voltage, over the pulse's width.
    pwm_hz : float
    """

    pull: Array
    apart_s: float
    widths_s: Sequence[Array]
    information: Array
    volts_per_s: float
    pwm_hz: float

    @property
    def reach_s(self) -> float:
        """From the narrowest pulse to the widest."""
        return max(float(w.max()) for w in self.widths_s) - min(float(w.min()) for w in self.widths_s)

    @cached_property
    def spectrum(self) -> Array:
        """Of the pull, complex; its lines are `apart_hz` apart."""
        return np.asarray(np.fft.rfft(self.pull))

    @property
    def apart_hz(self) -> float:
        return 1.0 / (len(self.pull) * self.apart_s)

    def gains(self, frequency: Array) -> Array:
        """What a sine of each frequency [1/s] in the volts by pulse width gains in log likelihood."""
        return np.asarray(np.abs(self._at(frequency)) ** 2 / float(self.information.sum()), dtype=np.float64)

    def _at(self, frequency: Array) -> Array:
        """Amplitudes (n,), complex, between the lines of the spectrum: cubics through four of them."""
        place = frequency / self.apart_hz
        first = np.clip(place.astype(np.int64) - 1, 0, len(self.spectrum) - 4)
        u, lines = place - first, self.spectrum
        weights = (
            -(u - 1.0) * (u - 2.0) * (u - 3.0) / 6.0,
            u * (u - 2.0) * (u - 3.0) / 2.0,
            -u * (u - 1.0) * (u - 3.0) / 2.0,
            u * (u - 1.0) * (u - 2.0) / 6.0,
        )
        return np.asarray(sum(w * lines[first + k] for k, w in enumerate(weights)))

    def informed(self, step_s: float) -> Array:
        """About each harmonic of a step's sawtooth; a command that stands still carries no information."""
        total, some = np.zeros(SAWTOOTH_HARMONICS), LINEAR_STRETCH_READINGS // COMMAND_STRIDE
        for width_s, information in zip(self.widths_s, self.information, strict=True):
            threshold = width_s[::COMMAND_STRIDE]
            parts = threshold[: len(threshold) // some * some].reshape(-1, some, 3)
            turn = np.exp(2j * np.pi / step_s * parts)
            turned = np.ones_like(turn)
            for m in range(SAWTOOTH_HARMONICS):
                turned *= turn
                total[m] += information * (1.0 - float((np.abs(turned.mean(axis=1)) ** 2).mean()))
        return total

    def rounding(self, step_s: float, rise: Array, fall: Array, informed: Array) -> tuple[Array, Array]:
        """What speaks for the rounding of a step with these phases, and the information about its size."""
        m = np.arange(1, 1 + SAWTOOTH_HARMONICS)
        turns = np.exp(-2j * np.pi * rise[..., None] * m) + np.exp(-2j * np.pi * fall[..., None] * m)
        scale = 0.5 * step_s * self.volts_per_s / np.pi
        towards = scale * ((np.conj(self._at(m / step_s)) * turns).imag / m).sum(axis=-1)
        size = 0.5 * scale**2 * (np.abs(turns) ** 2 * informed / m**2).sum(axis=-1)
        return towards, np.maximum(size, np.finfo(np.float64).tiny)

    def phases(self, step_s: float, informed: Array) -> tuple[TimerPhases, float, float]:
        """The likeliest phases of a step, what speaks for its rounding, and the information about its size."""
        parts = np.arange(PHASES_PER_STEP) / PHASES_PER_STEP
        towards, size = self.rounding(step_s, parts[:, None], parts[None], informed)
        gain = np.where(towards > 0.0, towards**2 / size, 0.0)
        rise, fall = np.unravel_index(int(np.argmax(gain)), gain.shape)
        found = TimerPhases(pwm_frequency_hz=self.pwm_hz, rise=parts[rise], fall=parts[fall])
        return found, float(towards[rise, fall]), float(size[rise, fall])


def _harmonic_sums(traces: Sequence[CommandTrace], centred: bool, bus_v: float) -> list[_HarmonicSums]:
    combs = []
    for pwm_hz in sorted({trace.pwm_hz for trace in traces}):
        there = [trace for trace in traces if trace.pwm_hz == pwm_hz]
        volts_per_s = leg_step_of(1.0, pwm_hz, bus_v)
        widths_s = [legs_of(trace.command_ab, centred) / volts_per_s for trace in there]
        # To a quarter of the finest saw's last harmonic.
        apart_s = LEAST_TIMER_STEP_S / (4.0 * SAWTOOTH_HARMONICS)
        place = np.round(np.concatenate(widths_s) / apart_s).astype(np.int64)
        count = ZERO_PADDING_FACTOR * 2 ** math.ceil(math.log2(2 * int(np.abs(place).max()) + 2))
        # Of the three legs' volts the machine feels the two-axis vector: the transpose of `from_phases`.
        pull_legs = 2.0 / 3.0 * to_phases(np.concatenate([trace.pull_ab for trace in there]))
        pull = np.bincount(np.mod(place, count).ravel(), weights=pull_legs.ravel(), minlength=count).astype(np.float64)
        information = 4.0 / 3.0 * np.array([trace.information for trace in there])
        combs.append(_HarmonicSums(pull, apart_s, widths_s, information, volts_per_s, pwm_hz))
    return combs


def _spectrum(combs: Sequence[_HarmonicSums]) -> tuple[Array, Array]:
    """Frequencies of the steps that are tried, and what a line of each gains in log likelihood."""
    apart = FREQUENCY_SPACING_LINEWIDTHS / max(comb.reach_s for comb in combs)
    frequency = np.arange(1.0 / MAX_TIMER_STEP_S, 1.0 / LEAST_TIMER_STEP_S, apart)
    gains = [comb.gains(frequency) for comb in combs]
    return frequency, np.sum(gains, axis=0)


def _background(gain: Array, frequencies: int) -> Array:
    """By how many times chance alone the median is, around each line."""
    from scipy.stats import gamma

    reach = min(BACKGROUND_HALF_WIDTH, len(gain) - 1)
    around = sliding_window_view(np.pad(gain, reach, mode="reflect"), 2 * reach + 1)
    places = np.arange(0, len(gain), max(1, reach // 4))
    medians = np.median(around[places], axis=1) / float(gamma.median(frequencies))
    return np.interp(np.arange(len(gain)), places, medians)


def _highest(gains: Array) -> list[int]:
    """Where the highest peaks are."""
    beside = np.maximum(np.append(gains[1:], -np.inf), np.append(-np.inf, gains[:-1]))
    return [int(k) for k in np.argsort(np.where(gains >= beside, gains, -np.inf))[: -1 - PEAKS_REFINED : -1]]


def _refine_line(
    combs: Sequence[_HarmonicSums], centred: bool, frequency: float, within: float
) -> tuple[ModulatorTimer, float]:
    """The likeliest timer whose line is there, and what its rounding gains in log likelihood, at its best size."""
    from scipy.optimize import minimize_scalar

    informed = [comb.informed(1.0 / frequency) for comb in combs]

    def there(at: float) -> tuple[ModulatorTimer, float]:
        parts = [comb.phases(1.0 / at, known) for comb, known in zip(combs, informed, strict=True)]
        towards, size = sum(part[1] for part in parts), sum(part[2] for part in parts)
        timer = ModulatorTimer(step_s=1.0 / at, centred=centred, phases=tuple(part[0] for part in parts))
        return timer, 0.5 * towards**2 / size if size > 0.0 else 0.0

    bounds = (frequency - within, frequency + within)
    best = minimize_scalar(lambda at: -there(at)[1], bounds=bounds, method="bounded", options={"maxiter": 20})
    return there(float(best.x))


def _block_consistency(traces: Sequence[CommandTrace], timer: ModulatorTimer, bus_v: float) -> float:
    """How well all parts of the readings agree that the rounding is there, as a log likelihood.

    Each is as uncertain as they differ: where few of them speak for it, it is theirs and no timer's. All three legs
    have the same timer, and any two of them two thirds of the say: a current control moves a leg in steps of its
    converters' least current, and what that does by chance is one leg's.
    """
    phases, scores = {p.pwm_frequency_hz: p for p in timer.phases}, list[Array]()
    for trace in traces:
        at, step_v = phases[trace.pwm_hz], leg_step_of(timer.step_s, trace.pwm_hz, bus_v)
        off = legs_rounded_by(trace.command_ab, step_v, at.rise, at.fall, timer.centred)
        each = 2.0 / 3.0 * to_phases(trace.pull_ab) * (off - off.mean(axis=0))
        scores.append(np.add.reduceat(each, np.arange(0, len(each), BLOCK_READINGS), axis=0))
    legs = np.concatenate(scores)
    two = min(_mean_evidence(np.delete(legs, leg, axis=1).sum(axis=1)) for leg in range(3))
    return min(_mean_evidence(legs.sum(axis=1)), 1.5 * two)


def _mean_evidence(witnesses: Array) -> float:
    """Log likelihood of a mean above zero, of witnesses that are as uncertain as they differ."""
    squares = float(witnesses @ witnesses)
    return 0.5 * max(float(witnesses.sum()), 0.0) ** 2 / squares if squares > 0.0 else 0.0


def _refine_estimate(
    combs: Sequence[_HarmonicSums], timer: ModulatorTimer, likelier: float, certain: float
) -> QuantiserEstimate:
    """The likeliest timer near one, its phases between the parts that are tried, and how well it is known.

    Parameters
    ----------
    likelier : float
        By how much its rounding is likelier than none, were chance all that there is beside it.
    certain : float
        By how much it is, with all that there is.
    """
    from scipy.optimize import minimize

    informed = [comb.informed(timer.step_s) for comb in combs]
    start = QuantiserEstimate(timer, certain, np.eye(1 + 2 * len(combs)))

    def cost(x: Array) -> float:
        there = start.moved(x)
        parts = [
            comb.rounding(there.step_s, np.array(p.rise), np.array(p.fall), about)
            for comb, p, about in zip(combs, there.phases, informed, strict=True)
        ]
        towards, size = (float(np.sum([one[k] for one in parts])) for k in (0, 1))
        return -0.5 * towards**2 / size * certain / likelier

    # Across the simplex the widest pulse moves by a tenth of a step.
    reach = max(comb.reach_s for comb in combs) / timer.step_s
    sizes = np.array([0.1 / reach, *[0.5 / PHASES_PER_STEP] * (2 * len(combs))])
    simplex = np.concatenate([np.zeros((1, len(sizes))), np.diag(sizes)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 0.01, "maxfev": 60 * len(sizes)}
    best = np.asarray(minimize(cost, np.zeros(len(sizes)), method="Nelder-Mead", options=options).x, dtype=np.float64)
    return QuantiserEstimate(start.moved(best), -cost(best), _with_phase_bias(_curvature(cost, best, sizes)))


def _with_phase_bias(curvature: Array) -> Array:
    """The curvature where phases may be wrong beside chance."""
    variance = np.diag([0.0, *[PHASE_BIAS_STD**2] * (len(curvature) - 1)])
    return np.asarray(curvature @ np.linalg.inv(np.eye(len(curvature)) + variance @ curvature), dtype=np.float64)


def _curvature(cost: Callable[[Array], float], at: Array, sizes: Array) -> Array:
    """Second derivatives by differences of these sizes; no direction is taken for a hill."""
    count, middle = len(at), cost(at)
    second = np.empty((count, count))
    for j, k in combinations_with_replacement(range(count), 2):
        one, other = np.eye(count)[j] * sizes, np.eye(count)[k] * sizes
        if j == k:
            value = cost(at + one) - 2.0 * middle + cost(at - one)
        else:
            ends = cost(at + one + other) - cost(at + one - other) - cost(at - one + other) + cost(at - one - other)
            value = 0.25 * ends
        second[j, k] = second[k, j] = value
    size, turn = np.linalg.eigh(second)
    return np.asarray((turn * np.maximum(size, 0.0)) @ turn.T / np.outer(sizes, sizes), dtype=np.float64)
