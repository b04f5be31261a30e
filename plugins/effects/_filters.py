"""First-order lags and high passes along time, as numba kernels; they know nothing of motors."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array
from plugins.effects._vectors import doubles
from protocols import RealArray


@njit(cache=True, nogil=True, inline="always")
def _weights(rate: float) -> tuple[float, float]:
    """What a lag keeps of itself over an interval of so many time constants, and takes of a change within it."""
    decay = math.exp(-rate)
    return decay, 1.0 - (1.0 - decay) / rate


@njit(cache=True, nogil=True)
def low_pass(x: Array, rate: float) -> Array:
    """First-order lag of each column of (n, m), from y_0 = x_0; exact for what is linear between samples.

    `rate` is the sampling interval in time constants.
    """
    decay, part = _weights(rate)
    y = np.empty_like(x)
    for m in range(x.shape[1]):
        y[0, m] = x[0, m]
        for k in range(1, x.shape[0]):
            y[k, m] = decay * y[k - 1, m] + (1.0 - decay) * x[k - 1, m] + part * (x[k, m] - x[k - 1, m])
    return y


@njit(cache=True, nogil=True)
def high_pass_means(x: Array, rate: float) -> Array:
    """Mean over each interval of x less its lag, the last interval's as the one before; exact as `low_pass`.

    By the lag's own equation, tau y' = x - y, that is what y changes by, over the interval in time constants.
    """
    y = low_pass(x, rate)
    last = x.shape[0] - 1
    for m in range(x.shape[1]):
        for k in range(last):
            y[k, m] = (y[k + 1, m] - y[k, m]) / rate
        y[last, m] = y[last - 1, m] if last > 0 else 0.0
    return y


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
