"""Dwells: stretches of constant current, where the rounding of a modulator's timer does not average out.

A varying voltage is dithered by its course, and current control that responds to noise dithers a constant one partly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.weak_form.segments import SegmentData, block_means
from orchestrator.numerics.types import Array
from protocols import SegmentStage

MAX_STEP_OF_DWELL = 0.02
"""Step of a constant current between windows, relative to a ramp's."""
MAX_STEP_OF_DWELL_SIGMAS = 4.0
"""The same in standard deviations of its noise, where that is more."""
MIN_WINDOWS_OF_DWELL = 3
"""Minimum number of windows in a stretch of constant current."""


def dwells(piece: SegmentData) -> tuple[slice, ...]:
    """Slices of a segment's samples with constant current: all of a hold, the plateaus of a sweep."""
    if piece.stage is SegmentStage.RESISTANCE:
        return (slice(0, len(piece.signals.v_dc)),)
    if piece.stage is not SegmentStage.CLASSICAL:
        return ()
    step = max(round(piece.windows.step), 1)
    means = block_means(np.asarray(piece.signals.i_ab), step)
    moved = np.hypot(*np.diff(means, axis=0).T)
    noise_a = math.sqrt(2.0 * float(np.trace(piece.scatter.covariance)) / (step * piece.averaged))
    stands = moved < max(MAX_STEP_OF_DWELL * float(moved.max(initial=0.0)), MAX_STEP_OF_DWELL_SIGMAS * noise_a)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2] + 1, strict=True)
    return tuple(slice(int(a) * step, int(b) * step) for a, b in runs if b - a >= MIN_WINDOWS_OF_DWELL)


@dataclass(frozen=True)
class QuantiserScatter:
    """Rounding of a segment's held voltages by a modulator's timer.

    Attributes
    ----------
    steps : array, shape (rests,)
        Timer step in volts, relative to that at the drive's nominal PWM frequency.
    trembling_v : array, shape (rests,)
        rms of a leg's commanded voltage around its mean.
    """

    steps: Array
    trembling_v: Array

    @classmethod
    def of(cls, piece: SegmentData) -> QuantiserScatter:
        """For the dwells of a segment."""
        s, found = piece.signals, dwells(piece)
        drive_hz = (s.drive.pwm_frequency_hz if s.drive is not None else None) or s.pwm_frequency_hz
        trembling = [math.sqrt(0.5 * float(s.v_ab[dwell].var(axis=0).sum())) for dwell in found]
        return cls(np.full(len(found), s.pwm_frequency_hz / drive_hz), np.array(trembling))

    def sizes(self, voltage_v: float, *, dithered: bool) -> Array:
        """Standard deviation of each dwell's voltage per axis [V]; `voltage_v` is that of an undithered unit step.

        If `dithered`, noise sigma scales harmonic m of the error's sawtooth by exp(-2 (pi m sigma / q)^2), q the step
        of a leg's voltage (B. Widrow, I. Kollar, Quantization Noise, doi:10.1017/CBO9780511754661).
        """
        if voltage_v == 0.0 or not dithered:
            return voltage_v * self.steps
        q = leg_step_v(voltage_v) * self.steps
        m = np.arange(1.0, 1.0 + SAWTOOTH_HARMONICS)
        # Noise above one step removes the error completely; limiting it avoids underflow.
        trembling = np.minimum(self.trembling_v / q, 10.0)
        kept = np.exp(-((2.0 * np.pi * m * trembling[:, None]) ** 2)) / m**2
        return np.asarray(voltage_v * self.steps * np.sqrt(kept.sum(axis=1) / (1.0 / m**2).sum()))


SAWTOOTH_HARMONICS = 20
"""Harmonics of the sawtooth that are summed: 97 % of its variance."""


def leg_step_v(voltage_v: float) -> float:
    """A leg's step whose uniform rounding error has this rms per axis [V]: sqrt(2/3) sqrt(1/12) of the step."""
    return math.sqrt(18.0) * voltage_v
