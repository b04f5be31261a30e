"""Vectors along time, shape (n, 2), changed in one pass by numba kernels; they know nothing of motors."""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array
from protocols import RealArray


def doubles(x: RealArray) -> Array:
    """As kernels are compiled for: float64 without gaps; the same array where it is that."""
    return np.ascontiguousarray(x, dtype=np.float64)


def less_constant(x: RealArray, constant: RealArray) -> Array:
    """x_k - c, c of shape (2,)."""
    return _less_constant(doubles(x), doubles(constant))


@njit(cache=True, nogil=True)
def _less_constant(x: Array, constant: Array) -> Array:
    out = np.empty_like(x)
    a, b = constant[0], constant[1]
    for k in range(x.shape[0]):
        out[k, 0] = x[k, 0] - a
        out[k, 1] = x[k, 1] - b
    return out


def plus_along(x: RealArray, sizes: RealArray, along: RealArray) -> Array:
    """x_k + s_k d_k, s of shape (n,), d of shape (n, 2), or of shape (1, 2): the same for all."""
    return _plus_along(doubles(x), doubles(sizes), doubles(along))


@njit(cache=True, nogil=True)
def _plus_along(x: Array, sizes: Array, along: Array) -> Array:
    out = np.empty_like(x)
    for k in range(x.shape[0]):
        m = min(k, along.shape[0] - 1)
        out[k, 0] = x[k, 0] + sizes[k] * along[m, 0]
        out[k, 1] = x[k, 1] + sizes[k] * along[m, 1]
    return out


def stretched(x: RealArray, matrix: RealArray) -> Array:
    """x_k M, M of shape (2, 2)."""
    return _stretched(doubles(x), doubles(matrix))


@njit(cache=True, nogil=True)
def _stretched(x: Array, matrix: Array) -> Array:
    out = np.empty_like(x)
    for k in range(x.shape[0]):
        out[k, 0] = x[k, 0] * matrix[0, 0] + x[k, 1] * matrix[1, 0]
        out[k, 1] = x[k, 0] * matrix[0, 1] + x[k, 1] * matrix[1, 1]
    return out


def less_of_means(x: RealArray, y: RealArray, matrix: RealArray) -> Array:
    """x_k - (y_k + y_k+1) / 2 M, M of shape (2, 2): beyond its end y stays as it is."""
    return _less_of_means(doubles(x), doubles(y), doubles(matrix))


@njit(cache=True, nogil=True)
def _less_of_means(x: Array, y: Array, matrix: Array) -> Array:
    out = np.empty_like(x)
    for k in range(x.shape[0]):
        after = min(k + 1, x.shape[0] - 1)
        a, b = 0.5 * (y[k, 0] + y[after, 0]), 0.5 * (y[k, 1] + y[after, 1])
        out[k, 0] = x[k, 0] - (a * matrix[0, 0] + b * matrix[1, 0])
        out[k, 1] = x[k, 1] - (a * matrix[0, 1] + b * matrix[1, 1])
    return out
