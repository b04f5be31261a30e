"""Shared parts of numba kernels: contiguous waveforms of one precision, and transforms of a single sample."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

Samples = NDArray[np.floating[Any]]


def for_kernels(*waveforms: Samples) -> tuple[Samples, ...]:
    """The arrays C-contiguous, all of float32 or all of float64.

    A copy in double precision costs as much as half a pass, and kernels are compiled for these two kinds only.
    """
    single = all(x.dtype == np.float32 for x in waveforms)
    if single:
        return tuple(np.ascontiguousarray(x, dtype=np.float32) for x in waveforms)
    return tuple(np.ascontiguousarray(x, dtype=np.float64) for x in waveforms)


@njit(cache=True, nogil=True, fastmath=True)
def phases_of(alpha: float, beta: float) -> tuple[float, float, float]:
    """One vector as phases a, b, c, as `frames.to_phases`."""
    across = 0.5 * math.sqrt(3.0) * beta
    return alpha, across - 0.5 * alpha, -across - 0.5 * alpha


@njit(cache=True, nogil=True, fastmath=True)
def vector_of(a: float, b: float, c: float) -> tuple[float, float]:
    """One sample's phases as (alpha, beta), as `frames.from_phases`."""
    return (2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)


@njit(cache=True, nogil=True, fastmath=True)
def dq_of(alpha: float, beta: float, cos: float, sin: float) -> tuple[float, float]:
    """One vector as (d, q) in the frame at the angle of this cosine and sine, as `frames.to_dq`."""
    return cos * alpha + sin * beta, cos * beta - sin * alpha


_MAX_SERIES_ANGLE_RAD = 0.25
"""Angle up to which a few terms of the series give cosine and sine to rounding."""


@njit(cache=True, nogil=True)
def unit_vectors(angle_rad: Array) -> Array:
    """Cosine and sine (n, 2) of angles (n,), by a short series where they hardly vary, as with a compliant brake."""
    n = angle_rad.shape[0]
    out = np.empty((n, 2))
    first, furthest = angle_rad[0], 0.0
    c, s = math.cos(first), math.sin(first)
    for k in range(n):
        a = angle_rad[k] - first
        furthest = max(furthest, abs(a))
        x = a * a
        cos = 1 + x * (-1 / 2 + x * (1 / 24 + x * (-1 / 720 + x * (1 / 40320 + x * (-1 / 3628800 + x / 479001600)))))
        sin = a * (1 + x * (-1 / 6 + x * (1 / 120 + x * (-1 / 5040 + x * (1 / 362880 - x / 39916800)))))
        out[k, 0] = c * cos - s * sin
        out[k, 1] = s * cos + c * sin
    if not furthest < _MAX_SERIES_ANGLE_RAD:
        for k in range(n):
            out[k, 0] = math.cos(angle_rad[k])
            out[k, 1] = math.sin(angle_rad[k])
    return out


@njit(cache=True, nogil=True)
def delayed_means(x: Array, width: int, late_by: int, part: float) -> Array:
    """Means of delayed rows between the middles of successive blocks of `width` rows; the last is its block's mean.

    Parameters
    ----------
    x : array, shape (n, m)
    width : int
    late_by, part : int, float
        Delay in whole and fractional rows; the first row is repeated for times before it.

    Returns
    -------
    array, shape (n // width, m)
        For block b and the next: mean over their pairs of readings of the sum in between, over `width`.
    """
    blocks, columns, last = x.shape[0] // width, x.shape[1], x.shape[0] - 1
    out = np.empty((blocks, columns))
    for c in range(columns):
        before = 0.0
        for b in range(blocks):
            # Within a block: the sum before each row, and the sum of all.
            ahead, total = 0.0, 0.0
            for k in range(b * width, (b + 1) * width):
                ahead += total
                later, earlier = min(max(k - late_by, 0), last), min(max(k - late_by - 1, 0), last)
                total += (1.0 - part) * x[later, c] + part * x[earlier, c]
            if b > 0:
                out[b - 1, c] = (before + ahead / width) / width
            before = total - ahead / width
            if b == blocks - 1:
                out[b, c] = total / width
    return out
