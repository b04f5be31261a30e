"""One-pass numba kernels on vectors along time, shape (N, 2).

Segments are concatenated: samples `starts[s]` up to `starts[s + 1]` are those of segment s.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.types import Array
from protocols import RealArray

Starts = NDArray[np.int64]


def doubles(x: RealArray) -> Array:
    """A contiguous float64 array as kernels expect; the same object where it is one already."""
    return np.ascontiguousarray(x, dtype=np.float64)


def less_constant(x: RealArray, starts: Starts, constants: RealArray) -> Array:
    """x_k - c_s, c of shape (segments, 2)."""
    return _less_constant(doubles(x), starts, doubles(constants))


@njit(cache=True, nogil=True)
def _less_constant(x: Array, starts: Starts, constants: Array) -> Array:
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        a, b = constants[s, 0], constants[s, 1]
        for k in range(starts[s], starts[s + 1]):
            out[k, 0] = x[k, 0] - a
            out[k, 1] = x[k, 1] - b
    return out


def times_matrix(x: RealArray, starts: Starts, matrices: RealArray) -> Array:
    """x_k M_s, M of shape (segments, 2, 2)."""
    return _times_matrix(doubles(x), starts, doubles(matrices))


@njit(cache=True, nogil=True)
def _times_matrix(x: Array, starts: Starts, matrices: Array) -> Array:
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        aa, ab, ba, bb = matrices[s, 0, 0], matrices[s, 0, 1], matrices[s, 1, 0], matrices[s, 1, 1]
        for k in range(starts[s], starts[s + 1]):
            out[k, 0] = x[k, 0] * aa + x[k, 1] * ba
            out[k, 1] = x[k, 0] * ab + x[k, 1] * bb
    return out


def plus_along_d(x: RealArray, starts: Starts, sizes: RealArray, theta_rad: RealArray) -> Array:
    """x_k + s_k d_k, s of shape (N,), d the unit vector at an angle of shape (N,)."""
    return _plus_along_d(doubles(x), starts, doubles(sizes), doubles(theta_rad))


@njit(cache=True, nogil=True)
def _plus_along_d(x: Array, starts: Starts, sizes: Array, theta_rad: Array) -> Array:
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        first = starts[s]
        # A segment's angle hardly changes from its first value.
        axis = unit_vectors(theta_rad[first : starts[s + 1]])
        for k in range(first, starts[s + 1]):
            out[k, 0] = x[k, 0] + sizes[k] * axis[k - first, 0]
            out[k, 1] = x[k, 1] + sizes[k] * axis[k - first, 1]
    return out


def minus_interval_means(x: RealArray, starts: Starts, y: RealArray, matrix: RealArray) -> Array:
    """x_k - (y_k + y_k+1) / 2 M, M of shape (2, 2); y is constant beyond a segment's end."""
    return _minus_interval_means(doubles(x), starts, doubles(y), doubles(matrix))


@njit(cache=True, nogil=True)
def _minus_interval_means(x: Array, starts: Starts, y: Array, matrix: Array) -> Array:
    out = np.empty_like(x)
    aa, ab, ba, bb = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    for s in range(starts.shape[0] - 1):
        last = starts[s + 1] - 1
        for k in range(starts[s], last + 1):
            after = min(k + 1, last)
            a, b = 0.5 * (y[k, 0] + y[after, 0]), 0.5 * (y[k, 1] + y[after, 1])
            out[k, 0] = x[k, 0] - (a * aa + b * ba)
            out[k, 1] = x[k, 1] - (a * ab + b * bb)
    return out
