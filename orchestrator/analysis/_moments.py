"""The one pass over the waveforms that demodulation needs: moments of ripple features, window by window.

Knows nothing of what the moments mean; `_symmetric` solves for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEATURES = 11
"""P (2), Q (2), second-order products of the flux ripple P - R Q (3), third-order ones (4)."""

_NO_DROP = np.zeros((2, 2))


@dataclass(frozen=True)
class Moments:
    """Sums over all windows of one capture.

    Attributes
    ----------
    normal : array, shape (13, 13)
        Products of the eleven features and the two currents, each without its mean and ramp in a window.
    mean_squares : array, shape (3,)
        Means of x_d^2, x_d x_q, x_q^2 of the flux ripple x = P - R Q.
    mean_i, mean_v2 : array of shape (2,), float
        Mean current; mean square of the voltage's ripple.
    samples, windows : int
    """

    normal: Array
    mean_squares: Array
    mean_i: Array
    mean_v2: float
    samples: int
    windows: int


def ripple_moments(
    i_ab: NDArray[np.floating[Any]],
    v_ab: NDArray[np.floating[Any]],
    *,
    sampling_s: float,
    angle_rad: float,
    delay: float,
    first: int,
    width: int,
    drop_ohm: Array = _NO_DROP,
) -> Moments:
    """Accumulate the moments in the frame at `angle_rad`, from row `first` on, in windows of `width` samples.

    v[k] acts from t_k + delay Ts on; `first` must not be less than `delay`. `drop_ohm`, shape (2, 2), is R of the
    flux ripple whose products are taken.
    """
    whole = math.floor(delay)
    windows = (len(i_ab) - first) // width
    i, v = (np.ascontiguousarray(x, dtype=np.float64) for x in (i_ab, v_ab))
    frame = (math.cos(angle_rad), math.sin(angle_rad))
    lag = (whole, delay - whole)
    normal, squares, mean_i, v2 = _accumulate(i, v, sampling_s, frame, lag, drop_ohm, first, width, windows)
    samples = windows * width
    return Moments(normal, squares / samples, mean_i / samples, v2 / samples, samples, windows)


@njit(cache=True, nogil=True, fastmath=True)
def _accumulate(
    i_ab: Array,
    v_ab: Array,
    sampling_s: float,
    frame: tuple[float, float],
    delay: tuple[int, float],
    drop_ohm: Array,
    first: int,
    width: int,
    windows: int,
) -> tuple[Array, Array, Array, float]:
    normal = np.zeros((13, 13))
    level, slope = np.zeros(13), np.zeros(13)
    squares, mean_i, v2 = np.zeros(3), np.zeros(2), 0.0
    z = np.empty((13, width))  # one row a feature, so that the products run along the samples
    v = np.empty((2, width))
    ramp = np.arange(width) - 0.5 * (width - 1)
    tt = (ramp * ramp).sum()
    for window in range(windows):
        start = first + window * width
        _rotate_window(i_ab, v_ab, frame, delay, start, z[11:], v)
        for axis in range(2):
            i_mean, v_mean = z[11 + axis].mean(), v[axis].mean()
            mean_i[axis] += width * i_mean
            z[11 + axis] -= i_mean
            v[axis] -= v_mean
            v2 += (v[axis] * v[axis]).sum()
        _fill_features(z, v, drop_ohm, sampling_s)
        for a in range(13):
            along, up = 0.0, 0.0
            for k in range(width):
                along += z[a, k]
                up += ramp[k] * z[a, k]
            level[a], slope[a] = along, up
            for b in range(a + 1):
                product = 0.0
                for k in range(width):
                    product += z[a, k] * z[b, k]
                normal[a, b] += product - along * level[b] / width - up * slope[b] / tt
        squares += level[4:7]
    for a in range(13):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return normal, squares, mean_i, v2


@njit(cache=True, nogil=True, fastmath=True)
def _rotate_window(
    i_ab: Array, v_ab: Array, frame: tuple[float, float], delay: tuple[int, float], start: int, i: Array, v: Array
) -> None:
    """Current, and the voltage that acts, of one window in the dq frame: rows d, q."""
    cos, sin = frame
    whole, part = delay
    for k in range(v.shape[1]):
        row = start + k
        a, b = i_ab[row, 0], i_ab[row, 1]
        i[0, k], i[1, k] = cos * a + sin * b, cos * b - sin * a
        a, b = v_ab[row - whole, 0], v_ab[row - whole, 1]
        if part > 0.0:
            a += part * (v_ab[row - whole - 1, 0] - a)
            b += part * (v_ab[row - whole - 1, 1] - b)
        v[0, k], v[1, k] = cos * a + sin * b, cos * b - sin * a


@njit(cache=True, nogil=True, fastmath=True)
def _fill_features(z: Array, v: Array, drop_ohm: Array, sampling_s: float) -> None:
    """Rows 0 to 10 of z from the zero-mean voltage v and the zero-mean current in rows 11 and 12."""
    for axis in range(2):
        p, q = 0.0, 0.0
        for k in range(v.shape[1]):
            z[axis, k] = p
            p += sampling_s * v[axis, k]
            z[2 + axis, k] = q + 0.5 * sampling_s * z[11 + axis, k]
            q += sampling_s * z[11 + axis, k]
        z[axis] -= z[axis].mean()
        z[2 + axis] -= z[2 + axis].mean()
    for k in range(v.shape[1]):
        d = z[0, k] - drop_ohm[0, 0] * z[2, k] - drop_ohm[0, 1] * z[3, k]
        q = z[1, k] - drop_ohm[1, 0] * z[2, k] - drop_ohm[1, 1] * z[3, k]
        z[4, k], z[5, k], z[6, k] = d * d, d * q, q * q
        z[7, k], z[8, k], z[9, k], z[10, k] = d * d * d, d * d * q, d * q * q, q * q * q
