"""What numba's kernels share: waveforms in one piece and one precision, and the phases of a single sample."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Samples = NDArray[np.floating[Any]]


def for_kernels(*waveforms: Samples) -> tuple[Samples, ...]:
    """The same arrays C-contiguous, all of float32 or all of float64.

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
