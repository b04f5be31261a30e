"""Timing errors: a delayed voltage, and a current sensor with a lag."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array
from plugins.effects._batches import BatchEffect
from plugins.effects._vectors import Starts, doubles
from protocols import Contrast, Correction, EffectLayer, EffectParameters, SignalBatch, amplitude


@njit(cache=True, nogil=True)
def _acting(v_ab: Array, late_ab: Array, starts: Starts, late: Array) -> tuple[Array, Array]:
    """Delayed mean voltage of each interval, and the voltage at its end minus that mean, shapes (N, 2).

    A segment's first and last values are repeated beyond its ends. A voltage that is early by a part of a sample is
    ignored at the end of the interval before, as the current's response takes longer.

    Parameters
    ----------
    late_ab : array, shape (N, 2) or (0, 2)
        Voltage at the end of an interval minus its mean; empty where zero.
    late : array, shape (segments,)
        Delay in samples.
    """
    out, end_minus_mean = np.empty_like(v_ab), np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        first, last = starts[s], starts[s + 1] - 1
        whole = math.floor(late[s])
        part = late[s] - whole
        for k in range(first, last + 1):
            near, far = min(max(k - whole, first), last), min(max(k - whole - 1, first), last)
            felt = far if whole < 0 and part > 0.0 else near
            for x in range(2):
                out[k, x] = (1.0 - part) * v_ab[near, x] + part * v_ab[far, x]
                end = v_ab[felt, x] + late_ab[felt, x] if late_ab.shape[0] > 0 else v_ab[felt, x]
                end_minus_mean[k, x] = end - out[k, x]
    return out, end_minus_mean


class VoltageDelay(BatchEffect):
    """v(t - T_d) [V]: each command acts T_d later than recorded; T_d in s.

    Over one interval the mean voltage is then (1 - T_d/Ts) v_k + (T_d/Ts) v_k-1.
    A whole sample at 4 kHz is within the bounds.
    """

    name: ClassVar[str] = "voltage_delay"
    summary: ClassVar[str] = "The voltage acts later than commanded."
    signature: ClassVar[str] = (
        "Ripple: the measured one is late, so that measured less model goes against the slope; by the same time "
        "at every frequency. Sweeps are as the model's."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.DELAY
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        delay_s: float = amplitude("s", typical=1e-5, prior_width=2e-5, low=-1e-4, high=3e-4)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """The mean voltage of each interval, and the voltage at its end minus that mean."""
        late_ab = np.zeros((0, 2)) if batch.v_late_ab is None else doubles(batch.v_late_ab)
        late = doubles(p.delay_s * batch.sampling_frequency_hz)
        acting, end_minus_mean = _acting(doubles(batch.v_ab), late_ab, batch.starts, late)
        return Correction(v_ab=acting, v_late_ab=end_minus_mean)


class CurrentFilter(BatchEffect):
    """First-order lag of the current sensors: tau dm/dt = i - m [A], tau in s.

    For a current linear between samples, d = i - m is d_k = E d_(k-1) + tau / T_s (1 - E) (i_k - i_(k-1)) with
    E = exp(-T_s / tau). For tau well below a sampling interval d is tau times the slope, like a delay of the voltage;
    for a long tau it falls with the ripple's frequency, unlike a delay. A wrong declared delay is the voltage's.
    """

    name: ClassVar[str] = "current_filter"
    summary: ClassVar[str] = "The current sensors lag."
    signature: ClassVar[str] = (
        "Ripple: the measured one is late, as from a late voltage: measured less model goes against the slope, "
        "less at high frequencies."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)
    gauge: ClassVar[str] = ""

    at_the_bench: ClassVar[str] = "look up the bandwidth of the current sensors, their amplifiers and filters"

    class Parameters(EffectParameters):
        time_constant_s: float = amplitude("s", typical=5e-6, prior_width=1e-5, low=0.0, high=1e-3)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """The current before the lag."""
        read = doubles(batch.i_ab)
        # The slope of noisy readings would be fitted as a signal.
        smooth = read if batch.i_smooth_ab is None else batch.i_smooth_ab
        samples = doubles(p.time_constant_s * batch.sampling_frequency_hz)
        return Correction(i_ab=_led(read, doubles(smooth), batch.starts, samples))


@njit(cache=True, nogil=True)
def _led(i_ab: Array, smooth_ab: Array, starts: Starts, samples: Array) -> Array:
    """Vectors (N, 2) before a lag of `samples` (segments,), from the smooth current limited to the reading's span."""
    out = np.empty_like(i_ab)
    for s in range(starts.shape[0] - 1):
        first, end = starts[s], starts[s + 1]
        stays = math.exp(-1.0 / samples[s]) if samples[s] > 0.0 else 0.0
        moves = samples[s] * (1.0 - stays)
        for axis in range(2):
            low, high = i_ab[first, axis], i_ab[first, axis]
            for k in range(first, end):
                low, high = min(low, i_ab[k, axis]), max(high, i_ab[k, axis])
            span = high - low
            # The current came to the first sample as it leaves it.
            second = min(first + 1, end - 1)
            before = _within(smooth_ab[first, axis], i_ab[first, axis], span)
            late = samples[s] * (_within(smooth_ab[second, axis], i_ab[second, axis], span) - before)
            out[first, axis] = i_ab[first, axis] + late
            for k in range(first + 1, end):
                near = _within(smooth_ab[k, axis], i_ab[k, axis], span)
                late = stays * late + moves * (near - before)
                out[k, axis] = i_ab[k, axis] + late
                before = near
    return out


@njit(cache=True, nogil=True, inline="always")
def _within(x: float, middle: float, span: float) -> float:
    return min(max(x, middle - span), middle + span)
