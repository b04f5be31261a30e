"""Lines in the spectrum of the current readings: disturbances at fixed frequencies.

The samples of a steady hold should differ by noise only. A line there is a disturbance of the readings or of the
voltage. Aliased switching ripple is absent with the bridge off and equally strong in every hold, and is included in the
noise. Any other line is an error that no effect explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array

MIN_LINE_FREQUENCY_HZ: float = 40.0
"""Frequency below which lines are not searched: current control responds to slow disturbances [Hz]."""
MIN_LINE_HEIGHT: float = 30.0
"""Height of a line over the median around it, in spectra averaged over all holds; chance does not reach it."""
MIN_LINE_RMS: float = 0.3
"""rms of a line in the hold where it is strongest, in standard deviations of a reading, from which it matters."""
MAX_RIPPLE_AMPLITUDE_SPREAD: float = 0.35
"""Largest spread of a switching ripple's amplitude from hold to hold, relative to its mean."""
LINE_BINS: tuple[int, int] = (4, 24)
"""Bins on either side of a line that belong to it (Hann window), and bins of its background."""
MAX_LINES: int = 6
"""Maximum number of lines."""


@dataclass(frozen=True)
class SpectralLine:
    """A line of the spectrum.

    Attributes
    ----------
    frequency_hz : float
    power : float
        Mean square in the holds, per axis [A^2].
    switching : bool
        Whether it is attributed to switching ripple.
    """

    frequency_hz: float
    power: float
    switching: bool


def spectrum_of(i_ab: Array) -> Array:
    """Mean square per axis and frequency bin of a steady segment's readings, shape (n // 2 + 1,): trend removed."""
    n = len(i_ab)
    t = np.linspace(-1.0, 1.0, n)
    centred = i_ab - i_ab.mean(axis=0)
    centred = centred - t[:, None] * (t @ centred / (t @ t))
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(centred * window[:, None], axis=0)) ** 2
    return np.asarray(power.mean(axis=1) / float(window @ window))


def find_lines(holds: Sequence[Array], off: Sequence[Array], fs: float) -> tuple[SpectralLine, ...]:
    """The lines that matter, strongest first.

    Parameters
    ----------
    holds, off : sequence of array
        `spectrum_of` holds, and of readings with the bridge off.
    """
    near, far = LINE_BINS
    length = max((len(s) for s in holds), default=0)
    spectra = np.array([s for s in holds if len(s) == length])
    if len(spectra) < 4 or length < 8 * far:
        return ()
    mean = spectra.mean(axis=0)
    noise = float(np.median(mean))
    step_hz = fs / (2.0 * (length - 1))
    # A line is a local maximum, unlike the falling spectrum of a current that is still settling.
    beside = np.pad(mean, 1, constant_values=0.0)
    remaining, lines = np.where((mean >= beside[:-2]) & (mean >= beside[2:]), mean, 0.0), []
    for _ in range(MAX_LINES):
        remaining[: max(2, math.ceil(MIN_LINE_FREQUENCY_HZ / step_hz))] = 0.0
        at = int(np.argmax(remaining))
        low, high = max(at - far, 1), min(at + far + 1, length)
        around = np.concatenate([mean[low : max(at - near, low)], mean[min(at + near + 1, high) : high]])
        if remaining[at] < MIN_LINE_HEIGHT * float(np.median(around)):
            break
        bins = slice(max(at - near, 0), min(at + near + 1, length))
        remaining[bins] = 0.0
        # A Hann window spreads a line over bins that add up to its power times n / 2 (twice at the very end).
        each = spectra[:, bins].sum(axis=1) / ((length - 1) * (1.0 if at < length - 2 else 2.0))
        size = np.sqrt(np.maximum(each, 0.0))
        if size.max() < MIN_LINE_RMS * math.sqrt(noise):
            continue
        quiet = all(_height(s, at * step_hz, fs) < MIN_LINE_HEIGHT for s in off)
        steady = float(np.std(size)) < MAX_RIPPLE_AMPLITUDE_SPREAD * float(np.mean(size))
        switching = bool(off) and quiet and steady and at < length - 2
        lines.append(SpectralLine(at * step_hz, float(each.mean()), switching))
    return tuple(lines)


def _height(spectrum: Array, frequency_hz: float, fs: float) -> float:
    """Height of a spectrum at a frequency over its median."""
    at = round(frequency_hz / fs * 2.0 * (len(spectrum) - 1))
    return float(spectrum[max(at - 2, 0) : at + 3].max() / max(float(np.median(spectrum)), 1e-300))


def added_noise(
    line: SpectralLine, fs: float, averaged: int, step: float, ohm: float, henry: float, variance: float
) -> float:
    """Power that a line adds to the equation of a test function, over that of white readings.

    Parameters
    ----------
    fs : float
        Frequency of the averaged samples.
    step : float
        Spacing of the test functions in samples.
    variance : float
        Variance of one averaged sample [A^2].
    """
    w = np.concatenate([[0.0], 1.0 - np.abs(np.arange(-round(step), round(step) + 1)) / step, [0.0]])
    # Each sample acts through the resistive drop and through the change of flux on both sides.
    weight = ohm / fs * 0.5 * (w[1:] + w[:-1]) + henry * np.diff(w)
    turn = 2.0 * math.pi * line.frequency_hz / fs
    seen = float(abs(np.sum(weight * np.exp(1j * turn * np.arange(len(weight))))) ** 2)
    part = turn / averaged
    mean = math.sin(0.5 * turn) / (averaged * math.sin(0.5 * part)) if averaged > 1 else 1.0
    return line.power * mean**2 * seen / (variance * float(weight @ weight))
