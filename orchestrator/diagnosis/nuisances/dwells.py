"""Where currents rest: what a modulator's timer cannot resolve of a voltage that stands still errs all through.

A voltage that moves is dithered by its own course, and one that current control trembles with noise is so in part.
Knows nothing of motors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.weak_form.segments import SegmentData, block_means
from orchestrator.numerics.types import Array
from protocols import SegmentStage


def dwells(piece: SegmentData, *, still: float = 0.02, certain: float = 4.0, least: int = 3) -> tuple[slice, ...]:
    """Samples of each stretch in which a segment's current stands still: all of a hold, the ends of a sweep's ramps.

    Parameters
    ----------
    still : float
        Step of the current from window to window, as a part of a ramp's, below which it stands, ...
    certain : float
        ... or standard deviations of the readings' noise in it, where that is more.
    least : int
        Windows that a stretch has at least.
    """
    if piece.stage is SegmentStage.RESISTANCE:
        return (slice(0, len(piece.signals.v_dc)),)
    if piece.stage is not SegmentStage.CLASSICAL:
        return ()
    step = max(round(piece.windows.step), 1)
    means = block_means(np.asarray(piece.signals.i_ab), step)
    moved = np.hypot(*np.diff(means, axis=0).T)
    noise_a = math.sqrt(2.0 * float(np.trace(piece.scatter.covariance)) / (step * piece.averaged))
    stands = moved < max(still * float(moved.max(initial=0.0)), certain * noise_a)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2] + 1, strict=True)
    return tuple(slice(int(a) * step, int(b) * step) for a, b in runs if b - a >= least)


@dataclass(frozen=True)
class QuantiserScatter:
    """What a modulator's timer does to a segment's held voltages, in units of what it does at its own PWM frequency.

    Attributes
    ----------
    steps : array, shape (rests,)
        A step of the timer in volts grows with the PWM frequency: that over the drive's own.
    trembling_v : array, shape (rests,)
        rms of a leg's commanded voltage around its mean.
    """

    steps: Array
    trembling_v: Array

    @classmethod
    def of(cls, piece: SegmentData) -> QuantiserScatter:
        """Of the rests of a segment."""
        s, found = piece.signals, dwells(piece)
        own = (s.drive.pwm_frequency_hz if s.drive is not None else None) or s.pwm_frequency_hz
        trembling = [math.sqrt(0.5 * float(s.v_ab[dwell].var(axis=0).sum())) for dwell in found]
        return cls(np.full(len(found), s.pwm_frequency_hz / own), np.array(trembling))

    def sizes(self, voltage_v: float, *, dithered: bool) -> Array:
        """Standard deviation of each rest's voltage on either axis [V], where nothing trembles `voltage_v` at one step.

        Noise dithers, if `dithered`: harmonic m of the error's sawtooth keeps exp(-2 (pi m sigma / q)^2) of itself,
        q the step of a leg's voltage (B. Widrow, I. Kollar, Quantization Noise, doi:10.1017/CBO9780511754661).
        """
        if voltage_v == 0.0 or not dithered:
            return voltage_v * self.steps
        q = leg_step_v(voltage_v) * self.steps
        m = np.arange(1.0, 1.0 + SAWTOOTH_HARMONICS)
        # What trembles by more than a step keeps nothing, by however much.
        trembling = np.minimum(self.trembling_v / q, 10.0)
        kept = np.exp(-((2.0 * np.pi * m * trembling[:, None]) ** 2)) / m**2
        return np.asarray(voltage_v * self.steps * np.sqrt(kept.sum(axis=1) / (1.0 / m**2).sum()))


SAWTOOTH_HARMONICS = 20
"""Of a saw-tooth, of whose variance they are 97 %."""


def leg_step_v(voltage_v: float) -> float:
    """A leg's step whose error, anywhere in it, is that much on an axis [V]: an axis has sqrt(2/3) of sqrt(1/12)."""
    return math.sqrt(18.0) * voltage_v
