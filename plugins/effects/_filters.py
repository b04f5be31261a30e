"""First-order lags and high passes along time, as numba kernels; they know nothing of motors."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array
from plugins.effects._vectors import doubles
from protocols import RealArray


@njit(cache=True, nogil=True)
def low_pass(x: Array, decay: float) -> Array:
    """y_k+1 = decay y_k + (1 - decay)(x_k + x_k+1)/2 on each column of (n, m), from y_0 = x_0."""
    y = np.empty_like(x)
    for m in range(x.shape[1]):
        y[0, m] = x[0, m]
        for k in range(1, x.shape[0]):
            y[k, m] = decay * y[k - 1, m] + (1.0 - decay) * 0.5 * (x[k - 1, m] + x[k, m])
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
