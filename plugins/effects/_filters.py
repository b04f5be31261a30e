"""First-order lags, high passes and second-order filters along time, as numba kernels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array, Indices
from plugins.effects._vectors import Starts, doubles
from protocols import RealArray


@njit(cache=True, nogil=True, inline="always")
def _weights(rate: float) -> tuple[float, float]:
    """Decay of a lag over an interval of `rate` time constants, and its response to a linear change within it."""
    decay = math.exp(-rate)
    return decay, 1.0 - (1.0 - decay) / rate


@njit(cache=True, nogil=True)
def low_pass(x: Array, starts: Starts, rates: Array) -> Array:
    """First-order lag (N,) of x (N,), starting at each segment's first value; exact for x linear between samples.

    `rates` (segments,) are sampling intervals in time constants.
    """
    y = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        decay, part = _weights(rates[s])
        y[starts[s]] = x[starts[s]]
        for k in range(starts[s] + 1, starts[s + 1]):
            y[k] = decay * y[k - 1] + (1.0 - decay) * x[k - 1] + part * (x[k] - x[k - 1])
    return y


@njit(cache=True, nogil=True)
def high_pass_means(x: Array, starts: Starts, rates: Array) -> Array:
    """Mean over each interval of x (N, m) minus its lag; a segment's last repeats the one before. Exact as `low_pass`.

    By the lag's equation tau y' = x - y, it is the change of y over the interval in time constants.
    """
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        decay, part = _weights(rates[s])
        first, last = starts[s], starts[s + 1] - 1
        for m in range(x.shape[1]):
            lag = x[first, m]
            for k in range(first, last):
                after = decay * lag + (1.0 - decay) * x[k, m] + part * (x[k + 1, m] - x[k, m])
                out[k, m] = (after - lag) / rates[s]
                lag = after
            out[last, m] = out[last - 1, m] if last > first else 0.0
    return out


@njit(cache=True, nogil=True)
def second_order(
    y: Array, x: Array, starts: Starts, which: Indices, above: Array, below: Array, resting: Array
) -> None:
    """Second-order filter of x (N,) into y (N,) for some segments, each in steady state at its first value.

    Parameters
    ----------
    which : array
        Indices of the segments.
    above, below : array, shape (3,)
        Numerator and denominator in falling powers of z, with below[0] = 1.
    resting : array, shape (2,)
        Steady state for x = 1, as from `scipy.signal.lfilter_zi`.
    """
    for s in which:
        one, two = resting[0] * x[starts[s]], resting[1] * x[starts[s]]
        for k in range(starts[s], starts[s + 1]):
            y[k] = one + above[0] * x[k]
            one = two + above[1] * x[k] - below[1] * y[k]
            two = above[2] * x[k] - below[2] * y[k]


@njit(cache=True, nogil=True)
def _lagged_steps(times: Array, values: Array, time_constant: float) -> Array:
    y = np.zeros_like(values)
    for m in range(1, values.shape[0]):
        decay = math.exp(-(times[m] - times[m - 1]) / time_constant)
        y[m] = decay * y[m - 1] + (1.0 - decay) * values[m - 1]
    return y


def lagged_steps(times: RealArray, values: RealArray, time_constant: float) -> Array:
    """First-order lag of a staircase (value m holds from time m to the next), at the steps, from zero."""
    return _lagged_steps(doubles(times), doubles(values), time_constant)
