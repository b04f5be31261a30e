"""Detection of a modulator's timer in raw readings, and estimate of its step and phases, without a motor model.

Over a tenth of a second a machine at standstill is linear: the next reading is a combination of the last readings and
commands. The residual of such a combination, fitted block by block, consists of noise and the response to the rounding
of recent commands. Rounding is a function of the command alone: sorted by command, the residual has a line in its
Fourier transform at one over the timer's step, whose harmonics give the two phases. All blocks and legs have to show
it, which excludes a pattern that one sweep, injection or phase makes by chance.
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

from orchestrator.diagnosis.nuisances.command_traces import LINEAR_STRETCH_READINGS, MIN_TIMER_STEP_S, CommandTrace
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate, leg_step_of, legs_of, legs_rounded_by
from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import ModulatorTimer, TimerPhases

MAX_TIMER_STEP_S: float = 3.5e-8
"""Largest step of a modulator's timer [s]: timers of drives run at 30 MHz and more."""

FREQUENCY_SPACING_LINEWIDTHS = 0.1
"""Spacing of the frequencies tried, in line widths."""
ZERO_PADDING_FACTOR = 8
"""Zero padding of the Fourier transform."""
COMMAND_STRIDE = 10
"""Stride of the commands from which their spread is estimated."""
BACKGROUND_HALF_WIDTH = 400
"""Frequencies on either side of a line from which the background is estimated."""
PEAKS_REFINED = 4
"""Number of lines that are refined with the complete sawtooth."""
SAWTOOTH_HARMONICS = 4
"""Harmonics of the sawtooth that are used: 87 % of its power."""
PHASES_PER_STEP = 32
"""Phases within a step that are tried for each edge."""
MIN_GAIN_RATIO_TO_BEST = 0.5
"""Gain of an alternative timer relative to the likeliest, below which it is dropped."""
SAME_STEP_TOLERANCE = 1e-3
"""Relative difference below which two steps are the same."""
PHASE_BIAS_STD = 0.06
"""Systematic error of phases from readings, in steps. On a recording of another plant a common phase of both edges was
estimated as two, 0.02 below and 0.14 above it, with a random error below 0.01."""
BLOCK_READINGS = 300
"""Readings in an independent block: longer than a machine's response to a command."""


def detect_quantisation(
    traces: Sequence[CommandTrace], bus_v: float, min_evidence: float
) -> tuple[QuantiserEstimate, ...]:
    """The detected timer and similar ones, the likeliest first; empty where none is detected.

    Parameters
    ----------
    traces : sequence of CommandTrace
    bus_v : float
        Nominal bus voltage for which pulses are computed [V].
    min_evidence : float
        Evidence required of line and blocks [nat]; for the line, the log of the number of steps tried is added.
    """
    if not traces:
        return ()
    found = list[tuple[float, QuantiserEstimate]]()
    for centred in (True, False):
        all_sums = _harmonic_sums(traces, centred, bus_v)
        frequency, gain = _spectrum(all_sums)
        chance = np.maximum(_background(gain, len(all_sums)), 1.0)
        threshold = min_evidence + math.log(2 * len(frequency))
        for k in _highest(gain / chance):
            # Phases that differ by half a step cancel the first harmonic.
            for tried in (frequency[k], 0.5 * frequency[k]):
                if tried < frequency[0]:
                    continue
                timer, likelier = _refine_line(all_sums, centred, float(tried), float(frequency[1] - frequency[0]))
                is_line = likelier > threshold * chance[k]
                if is_line and (consistency := _block_consistency(traces, timer, bus_v)) > min_evidence:
                    certain = min(likelier / float(chance[k]), consistency)
                    estimate = _refine_estimate(all_sums, timer, likelier, certain)
                    found.append((likelier, estimate))
    return _most_certain(found)


def _most_certain(found: Sequence[tuple[float, QuantiserEstimate]]) -> tuple[QuantiserEstimate, ...]:
    """The likeliest timer by the readings' likelihood and its near alternatives, each once."""
    certain = max((estimate.gain for _, estimate in found), default=0.0)
    best = list[QuantiserEstimate]()
    for _, one in sorted(found, key=lambda one: -one[0]):
        if one.gain > MIN_GAIN_RATIO_TO_BEST * certain and not any(_same(one.timer, other.timer) for other in best):
            best.append(one)
    return tuple(best)


def _same(one: ModulatorTimer, other: ModulatorTimer) -> bool:
    return one.centred == other.centred and math.isclose(one.step_s, other.step_s, rel_tol=SAME_STEP_TOLERANCE)


@dataclass(frozen=True)
class _HarmonicSums:
    """Likelihood gradient of the legs' voltages at one PWM frequency, summed by pulse width.

    Attributes
    ----------
    pull : array, shape (n,)
        Gradient of the log likelihood by a leg's voltage, summed over commands in each bin of pulse width [1/V].
    spacing_s : float
        Bin width; the first bin is zero width, the second half holds negative widths (FFT order).
    widths_s : sequence of array, shape (readings, 3)
        Pulse widths of each block.
    information : array, shape (blocks,)
        Information on a leg's voltage, summed over all legs' commands [1/V^2].
    volts_per_s : float
        A leg's mean voltage per pulse width.
    pwm_hz : float
    """

    pull: Array
    spacing_s: float
    widths_s: Sequence[Array]
    information: Array
    volts_per_s: float
    pwm_hz: float

    @property
    def reach_s(self) -> float:
        """Widest minus narrowest pulse."""
        return max(float(w.max()) for w in self.widths_s) - min(float(w.min()) for w in self.widths_s)

    @cached_property
    def spectrum(self) -> Array:
        """Complex Fourier transform of `pull`, with a spacing of `spacing_hz`."""
        return np.asarray(np.fft.rfft(self.pull))

    @property
    def spacing_hz(self) -> float:
        return 1.0 / (len(self.pull) * self.spacing_s)

    def gains(self, frequency: Array) -> Array:
        """Gain in log likelihood by a sine of each frequency [1/s] in the voltage over pulse width."""
        return np.asarray(np.abs(self._at(frequency)) ** 2 / float(self.information.sum()), dtype=np.float64)

    def _at(self, frequency: Array) -> Array:
        """Complex amplitudes (n,) between the lines of the spectrum, by cubic interpolation."""
        place = frequency / self.spacing_hz
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
        """Information on each harmonic of a step's sawtooth; constant commands carry none."""
        total, stretch = np.zeros(SAWTOOTH_HARMONICS), LINEAR_STRETCH_READINGS // COMMAND_STRIDE
        for width_s, information in zip(self.widths_s, self.information, strict=True):
            threshold = width_s[::COMMAND_STRIDE]
            parts = threshold[: len(threshold) // stretch * stretch].reshape(-1, stretch, 3)
            turn = np.exp(2j * np.pi / step_s * parts)
            turned = np.ones_like(turn)
            for m in range(SAWTOOTH_HARMONICS):
                turned *= turn
                total[m] += information * (1.0 - float((np.abs(turned.mean(axis=1)) ** 2).mean()))
        return total

    def rounding(self, step_s: float, rise: Array, fall: Array, informed: Array) -> tuple[Array, Array]:
        """Gradient for the rounding with these phases, and the information about its size."""
        m = np.arange(1, 1 + SAWTOOTH_HARMONICS)
        turns = np.exp(-2j * np.pi * rise[..., None] * m) + np.exp(-2j * np.pi * fall[..., None] * m)
        scale = 0.5 * step_s * self.volts_per_s / np.pi
        towards = scale * ((np.conj(self._at(m / step_s)) * turns).imag / m).sum(axis=-1)
        size = 0.5 * scale**2 * (np.abs(turns) ** 2 * informed / m**2).sum(axis=-1)
        return towards, np.maximum(size, np.finfo(np.float64).tiny)

    def phases(self, step_s: float, informed: Array) -> tuple[TimerPhases, float, float]:
        """The likeliest phases of a step, the gradient for its rounding, and the information about its size."""
        parts = np.arange(PHASES_PER_STEP) / PHASES_PER_STEP
        towards, size = self.rounding(step_s, parts[:, None], parts[None], informed)
        gain = np.where(towards > 0.0, towards**2 / size, 0.0)
        rise, fall = np.unravel_index(int(np.argmax(gain)), gain.shape)
        found = TimerPhases(pwm_frequency_hz=self.pwm_hz, rise=parts[rise], fall=parts[fall])
        return found, float(towards[rise, fall]), float(size[rise, fall])


def _harmonic_sums(traces: Sequence[CommandTrace], centred: bool, bus_v: float) -> list[_HarmonicSums]:
    all_sums = []
    for pwm_hz in sorted({trace.pwm_hz for trace in traces}):
        selected = [trace for trace in traces if trace.pwm_hz == pwm_hz]
        volts_per_s = leg_step_of(1.0, pwm_hz, bus_v)
        widths_s = [legs_of(trace.command_ab, centred) / volts_per_s for trace in selected]
        # A quarter of the period of the finest sawtooth's last harmonic.
        spacing_s = MIN_TIMER_STEP_S / (4.0 * SAWTOOTH_HARMONICS)
        place = np.round(np.concatenate(widths_s) / spacing_s).astype(np.int64)
        count = ZERO_PADDING_FACTOR * 2 ** math.ceil(math.log2(2 * int(np.abs(place).max()) + 2))
        # The machine responds to the two-axis vector of the legs' voltages: the transpose of `from_phases`.
        pull_legs = 2.0 / 3.0 * to_phases(np.concatenate([trace.pull_ab for trace in selected]))
        pull = np.bincount(np.mod(place, count).ravel(), weights=pull_legs.ravel(), minlength=count).astype(np.float64)
        information = 4.0 / 3.0 * np.array([trace.information for trace in selected])
        all_sums.append(_HarmonicSums(pull, spacing_s, widths_s, information, volts_per_s, pwm_hz))
    return all_sums


def _spectrum(all_sums: Sequence[_HarmonicSums]) -> tuple[Array, Array]:
    """Frequencies of the steps tried, and the gain in log likelihood by a line of each."""
    spacing_hz = FREQUENCY_SPACING_LINEWIDTHS / max(sums.reach_s for sums in all_sums)
    frequency = np.arange(1.0 / MAX_TIMER_STEP_S, 1.0 / MIN_TIMER_STEP_S, spacing_hz)
    gains = [sums.gains(frequency) for sums in all_sums]
    return frequency, np.sum(gains, axis=0)


def _background(gain: Array, frequencies: int) -> Array:
    """Median gain around each line over that by chance alone."""
    from scipy.stats import gamma

    reach = min(BACKGROUND_HALF_WIDTH, len(gain) - 1)
    around = sliding_window_view(np.pad(gain, reach, mode="reflect"), 2 * reach + 1)
    places = np.arange(0, len(gain), max(1, reach // 4))
    medians = np.median(around[places], axis=1) / float(gamma.median(frequencies))
    return np.interp(np.arange(len(gain)), places, medians)


def _highest(gains: Array) -> list[int]:
    """Indices of the highest peaks."""
    beside = np.maximum(np.append(gains[1:], -np.inf), np.append(-np.inf, gains[:-1]))
    return [int(k) for k in np.argsort(np.where(gains >= beside, gains, -np.inf))[: -1 - PEAKS_REFINED : -1]]


def _refine_line(
    all_sums: Sequence[_HarmonicSums], centred: bool, frequency: float, within: float
) -> tuple[ModulatorTimer, float]:
    """The likeliest timer near a line, and the gain in log likelihood by its rounding with a free size."""
    from scipy.optimize import minimize_scalar

    informed = [sums.informed(1.0 / frequency) for sums in all_sums]

    def evaluate(at: float) -> tuple[ModulatorTimer, float]:
        parts = [sums.phases(1.0 / at, known) for sums, known in zip(all_sums, informed, strict=True)]
        towards, size = sum(part[1] for part in parts), sum(part[2] for part in parts)
        timer = ModulatorTimer(step_s=1.0 / at, centred=centred, phases=tuple(part[0] for part in parts))
        return timer, 0.5 * towards**2 / size if size > 0.0 else 0.0

    bounds = (frequency - within, frequency + within)
    best = minimize_scalar(lambda at: -evaluate(at)[1], bounds=bounds, method="bounded", options={"maxiter": 20})
    return evaluate(float(best.x))


def _block_consistency(traces: Sequence[CommandTrace], timer: ModulatorTimer, bus_v: float) -> float:
    """Log likelihood of the rounding from the agreement of independent blocks, whose scatter is the uncertainty."""
    # Legs share the timer; the smallest evidence of any two legs counts, as steps of a current control with coarse
    # converters may imitate rounding in one.
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
    """Log likelihood of a mean above zero, with the uncertainty from the scatter."""
    squares = float(witnesses @ witnesses)
    return 0.5 * max(float(witnesses.sum()), 0.0) ** 2 / squares if squares > 0.0 else 0.0


def _refine_estimate(
    all_sums: Sequence[_HarmonicSums], timer: ModulatorTimer, likelier: float, certain: float
) -> QuantiserEstimate:
    """The likeliest timer near one, with continuous phases, and its curvature."""
    # `likelier` and `certain`: gain in log likelihood over chance alone, and over the actual background.
    from scipy.optimize import minimize

    informed = [sums.informed(timer.step_s) for sums in all_sums]
    start = QuantiserEstimate(timer, certain, np.eye(1 + 2 * len(all_sums)))

    def cost(x: Array) -> float:
        moved = start.moved(x)
        parts = [
            sums.rounding(moved.step_s, np.array(p.rise), np.array(p.fall), about)
            for sums, p, about in zip(all_sums, moved.phases, informed, strict=True)
        ]
        towards, size = (float(np.sum([one[k] for one in parts])) for k in (0, 1))
        return -0.5 * towards**2 / size * certain / likelier

    # Within the initial simplex the widest pulse moves by a tenth of a step.
    reach = max(sums.reach_s for sums in all_sums) / timer.step_s
    sizes = np.array([0.1 / reach, *[0.5 / PHASES_PER_STEP] * (2 * len(all_sums))])
    simplex = np.concatenate([np.zeros((1, len(sizes))), np.diag(sizes)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 0.01, "maxfev": 60 * len(sizes)}
    best = np.asarray(minimize(cost, np.zeros(len(sizes)), method="Nelder-Mead", options=options).x, dtype=np.float64)
    return QuantiserEstimate(start.moved(best), -cost(best), _with_phase_bias(_curvature(cost, best, sizes)))


def _with_phase_bias(curvature: Array) -> Array:
    """The curvature with `PHASE_BIAS_STD` added to the phases."""
    variance = np.diag([0.0, *[PHASE_BIAS_STD**2] * (len(curvature) - 1)])
    return np.asarray(curvature @ np.linalg.inv(np.eye(len(curvature)) + variance @ curvature), dtype=np.float64)


def _curvature(cost: Callable[[Array], float], at: Array, sizes: Array) -> Array:
    """Second derivatives by finite differences; negative eigenvalues are set to zero."""
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
