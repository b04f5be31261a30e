"""Windows of the weak form: overlapping test functions in time, times Fourier modes of an injection period.

A weight is w_mk = s_j(k) c_h(b(k)): s_j a triangular test function, c_h a mode that depends only on the bin b(k) of
interval k within the injection period. Sums are by (test function, bin); the modes are one small product afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Windows:
    """Weights of one segment's intervals.

    Attributes
    ----------
    test_functions : int
        Number of test functions; function j peaks at interval position (j + 1) * step and is zero one step away.
    step : float
        Spacing of the test functions in intervals.
    bins : array of int64, shape (n - 1,)
        Bin of each interval within the injection period; zeros without injection.
    modes : array, shape (modes, n_bins)
        Value of each mode in each bin.
    period : float
        Intervals in an injection period; 0 without injection.
    orders : tuple of int
        Fourier order of each mode; 0 for the mean.
    unread : int, optional
        The axis whose current was not measured (0 for d, 1 for q); its equations are zero.
    """

    test_functions: int
    step: float
    bins: NDArray[np.int64]
    modes: Array
    period: float = 0.0
    orders: tuple[int, ...] = (0,)
    unread: int | None = None

    @property
    def n_bins(self) -> int:
        return int(self.modes.shape[1])

    @property
    def rows(self) -> int:
        """Number of weak-form equations: test functions x modes x two axes."""
        return self.test_functions * len(self.modes) * 2

    @property
    def informative(self) -> int:
        """Number of equations of measured axes."""
        return self.rows if self.unread is None else self.rows // 2

    def combine(self, sums: Array) -> Array:
        """Apply the modes to sums (test_functions, n_bins, 2, ...); rows are ordered by test function, mode, axis."""
        if self.modes.size != 1:
            sums = np.moveaxis(np.tensordot(self.modes, sums, axes=(1, 1)), 0, 1)
        rows = np.ascontiguousarray(sums).reshape(self.rows, *sums.shape[3:])
        if self.unread is None:
            return rows
        rows = rows.copy()
        rows[self.unread :: 2] = 0.0
        return rows

    @cached_property
    def absolute_weight(self) -> Array:
        """sum_k |w_mk| of each row, shape (rows,); y_m / Ts over it is a mean."""
        mean = np.abs(self.modes).mean(axis=1) if self.n_bins > 1 else np.ones(1)
        return np.repeat(np.tile(mean * self.step, self.test_functions), 2)


def plain_windows(intervals: int, step: float) -> Windows | None:
    """Test functions spaced by `step`, without modes; None where none fits."""
    test_functions = math.floor(intervals / step + 1e-9) - 1
    if test_functions < 1:
        return None
    return Windows(test_functions, step, np.zeros(intervals, dtype=np.int64), np.ones((1, 1)))


def periodic_windows(
    intervals: int, step: float, period: float, max_bins: int, harmonics: Sequence[int] = (1, 2, 3, 5)
) -> Windows | None:
    """Test functions spaced by `step`, times the mean and Fourier modes of a period of `period` samples.

    The period need not be a whole number of samples: any weight gives a valid equation, and bins define the weight.
    """
    test_functions = math.floor(intervals / step + 1e-9) - 1
    if test_functions < 1:
        return None
    n_bins = int(min(round(period), max_bins))
    phase = np.mod((np.arange(intervals) + 0.5) / period, 1.0)
    bins = np.minimum((phase * n_bins).astype(np.int64), n_bins - 1)
    centre = 2 * np.pi * (np.arange(n_bins) + 0.5) / n_bins
    seen = [order for order in harmonics if order < n_bins / 2]
    modes = [wave(order * centre) for order in seen for wave in (np.cos, np.sin)]
    orders = (0, *(order for order in seen for _ in range(2)))
    return Windows(test_functions, step, bins, np.array([np.ones(n_bins), *modes]), period, orders)


@njit(cache=True, nogil=True)
def function_weights(k: int, step: float, test_functions: int) -> tuple[int, float, float]:
    """Index of the test function before interval k (-1: none), its weight, and that of the next."""
    x = (k + 0.5) / step
    before = math.floor(x) - 1
    after = x - math.floor(x)
    w0 = 1.0 - after
    w1 = after
    if before < 0 or before >= test_functions:
        w0 = 0.0
    if before + 1 >= test_functions or before + 1 < 0:
        w1 = 0.0
    return before, w0, w1


@njit(cache=True, nogil=True)
def sum_intervals(x: Array, step: float, test_functions: int, bins: NDArray[np.int64], n_bins: int) -> Array:
    """Weighted sums of per-interval vectors x (n - 1, 2), shape (test_functions, n_bins, 2)."""
    out = np.zeros((test_functions, n_bins, 2))
    for k in range(x.shape[0]):
        j, w0, w1 = function_weights(k, step, test_functions)
        b = bins[k]
        if w0 > 0.0:
            out[j, b, 0] += w0 * x[k, 0]
            out[j, b, 1] += w0 * x[k, 1]
        if w1 > 0.0:
            out[j + 1, b, 0] += w1 * x[k, 0]
            out[j + 1, b, 1] += w1 * x[k, 1]
    return out
