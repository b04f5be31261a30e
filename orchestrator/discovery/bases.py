"""Flexible laws of a quantity, linear in their coefficients: a curve, harmonics of an angle, and sums of memories.

The coefficients c are random with a precision K / tau^2, whose K penalises the curve's second differences (a P-spline;
P. H. C. Eilers, B. D. Marx, Stat. Sci. 11 (1996) 89, doi:10.1214/ss/1038425655) and, weakly, its size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.discovery.memory import cooled, lagged, play
from orchestrator.numerics.types import Array
from protocols import SignalBatch

DEGREE: int = 3
RIDGE: float = 0.05
"""Precision of a coefficient's size, relative to that of its second differences."""
KNEE: float = 0.03
"""Part of a signed quantity's range below which knots are even; beyond, they are spaced geometrically."""

Parity = Literal["odd", "even", "none", "periodic"]
MEMORIES = ("lag", "play", "cooling", "late")
"""Kinds of memory."""


class Basis(Protocol):
    """Columns of a flexible law."""

    @property
    def size(self) -> int:
        """Number of coefficients."""
        ...

    @property
    def kind(self) -> str: ...

    def design(self, x: Array) -> Array:
        """Values of all functions at x (n,), shape (n, size); of memory, what shows it there."""
        ...

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        """Columns over the samples of x (n, m), shape (size, n m); over each interval's `mean` or at its start."""
        ...


@dataclass(frozen=True)
class CurveBasis:
    """A cubic B-spline over a range; over a signed quantity its odd or even part.

    Attributes
    ----------
    low, high : float
        Range of x; of |x| where there is a parity.
    cells : int
    parity : {"odd", "even", "none"}
    knee : float
        Knots are even in asinh(x / knee); infinite for even ones in x.
    """

    low: float
    high: float
    cells: int
    parity: Parity
    knee: float = np.inf
    kind: str = "curve"

    @cached_property
    def knots(self) -> Array:
        """In the warped coordinate."""
        ends = self._warped(np.array([self.low, self.high]))
        inner = np.linspace(ends[0], ends[1], self.cells + 1)
        return np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])

    @property
    def size(self) -> int:
        return self.cells + DEGREE - (self.parity == "odd")

    def design(self, x: Array) -> Array:
        """Values of all functions at x (n,), shape (n, size); constant beyond the range."""
        return self._columns(x[:, None], np.array([0, len(x)]), mean=False).T

    def grid(self, points: int) -> Array:
        """Values of x over the range, evenly in the warped coordinate."""
        u = np.linspace(self.knots[0], self.knots[-1], points)
        return u if np.isinf(self.knee) else np.asarray(self.knee * np.sinh(u), dtype=np.float64)

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        return self._columns(x, batch.starts, mean)

    def _columns(self, x: Array, starts: NDArray[np.int64], mean: bool) -> Array:
        out = np.zeros((self.size, x.size))
        parity = ("even", "none", "odd").index(self.parity)
        _fill(np.ascontiguousarray(x, dtype=np.float64), starts, self.knots, self.knee, parity, mean, out)
        return out

    def _warped(self, x: Array) -> Array:
        return x if np.isinf(self.knee) else np.arcsinh(x / self.knee)


@dataclass(frozen=True)
class HarmonicBasis(CurveBasis):
    """cos x, sin x, cos 2 x, ... of an angle x, up to as many harmonics as `cells`."""

    @property
    def size(self) -> int:
        return 2 * self.cells

    def grid(self, points: int) -> Array:
        return np.linspace(self.low, self.high, points)

    def _columns(self, x: Array, starts: NDArray[np.int64], mean: bool) -> Array:
        # An angle hardly moves within an interval.
        turns = np.arange(1, self.cells + 1)[:, None] * x.ravel()
        return np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(self.size, x.size)


@dataclass(frozen=True)
class MemoryBasis:
    """x less its lags of several time constants or less its plays of several radii, the heat left of x, x late, or
    steps at several values of x.

    Attributes
    ----------
    kind : {"lag", "play", "cooling", "late", "step"}
    values : tuple of float
        Time constants [s], or radii or values in the unit of x.
    """

    kind: str
    values: tuple[float, ...]

    @property
    def size(self) -> int:
        return len(self.values)

    def design(self, x: Array) -> Array:
        """What shows it, shape (n, size): a play's first rise to x, else what there is a time x after a unit step."""
        return np.stack([memory_response(self.kind, x, value) for value in self.values], axis=1)

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        out = np.empty((self.size, x.size))
        last = batch.starts[1:] - 1
        for j, value in enumerate(self.values):
            y = self._memory(x, value, batch)
            if mean:
                after = np.roll(y, -1, axis=0)
                after[last] = y[last]
                y = 0.5 * (y + after)
            out[j] = y.ravel()
        return out

    def _memory(self, x: Array, value: float, batch: SignalBatch) -> Array:
        if self.kind == "cooling":
            return cooled(x[:, 0], value, batch)[:, None]
        if self.kind == "late":
            return lagged(x, value, batch)
        if self.kind == "step":
            return np.asarray(x >= value, dtype=np.float64)
        return x - (lagged if self.kind == "lag" else play)(x, value, batch)


@dataclass(frozen=True)
class LineBasis:
    """sin and cos at one frequency, of all alike or of phases a and b each for itself: of three, two are independent.

    Attributes
    ----------
    frequency_hz : float
    spacing_hz : float
        Distance to another frequency that the experiment's length tells from it.
    each : bool
        Whether phases a and b have amplitudes of their own.
    """

    frequency_hz: float
    spacing_hz: float
    each: bool
    kind: str = "line"

    @property
    def size(self) -> int:
        return 4 if self.each else 2

    def design(self, x: Array) -> Array:
        """At times x (n,), shape (n, size); of two phases, the first one's."""
        turns = 2.0 * np.pi * self.frequency_hz * x
        return np.stack([np.sin(turns), np.cos(turns), *[np.zeros_like(x)] * (self.size - 2)], axis=1)

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        waves = self.design(x[:, 0])[:, :2].T
        if not self.each:
            return np.ascontiguousarray(waves)
        out = np.zeros((2, 2, len(x), 3))
        for phase in range(2):
            out[phase, :, :, phase] = waves
        return out.reshape(self.size, -1)


def memory_response(kind: str, x: Array, value: float) -> Array:
    """A play's distance on its first rise to x; else what there is a time x after a unit step."""
    if kind == "play":
        return np.minimum(x, value)
    left = np.asarray(np.exp(-x / value), dtype=np.float64)
    return 1.0 - left if kind == "late" else left


def penalty(basis: Basis) -> Array:
    """K, shape (size, size); of harmonics, the square of their second derivatives."""
    if isinstance(basis, HarmonicBasis):
        return np.diag(np.repeat(np.arange(1.0, basis.cells + 1.0) ** 4, 2))
    bend = np.diff(np.eye(basis.size), 2, axis=0)
    return bend.T @ bend + RIDGE * np.eye(basis.size) if basis.kind == "curve" else np.eye(basis.size)


EVEN, NO_PARITY, ODD = 0, 1, 2


@njit(cache=True, nogil=True)
def _fill(
    x: Array, starts: NDArray[np.int64], knots: Array, knee: float, parity: int, mean: bool, out: Array
) -> None:  # fmt: skip
    """Values at each sample, or by Simpson's rule over the interval after it; nothing follows a segment's last one."""
    for s in range(starts.shape[0] - 1):
        for k in range(starts[s], starts[s + 1]):
            after = min(k + 1, starts[s + 1] - 1)
            for m in range(x.shape[1]):
                row = k * x.shape[1] + m
                if mean:
                    _add(x[k, m], 1.0 / 6.0, knots, knee, parity, out, row)
                    _add(0.5 * (x[k, m] + x[after, m]), 4.0 / 6.0, knots, knee, parity, out, row)
                    _add(x[after, m], 1.0 / 6.0, knots, knee, parity, out, row)
                else:
                    _add(x[k, m], 1.0, knots, knee, parity, out, row)


@njit(cache=True, nogil=True)
def _add(x: float, weight: float, knots: Array, knee: float, parity: int, out: Array, row: int) -> None:
    """Add the weighted values of the four cubic B-splines at x that are not zero, by de Boor's recurrence."""
    u = x if parity == NO_PARITY else abs(x)
    if not math.isinf(knee):
        u = math.asinh(u / knee)
    low, high = knots[DEGREE], knots[-DEGREE - 1]
    u = min(max(u, low), high)
    cells = knots.shape[0] - 2 * DEGREE - 1
    first = min(int((u - low) / (high - low) * cells), cells - 1)
    at = first + DEGREE
    b0, b1, b2, b3 = 1.0, 0.0, 0.0, 0.0
    for degree in range(1, DEGREE + 1):
        kept = 0.0
        for j in range(degree):
            right, left = knots[at + 1 + j], knots[at + 1 + j - degree]
            old = b0 if j == 0 else b1 if j == 1 else b2
            part = old / (right - left)
            new = kept + (right - u) * part
            kept = (u - left) * part
            if j == 0:
                b0 = new
            elif j == 1:
                b1 = new
            else:
                b2 = new
        if degree == 1:
            b1 = kept
        elif degree == 2:
            b2 = kept
        else:
            b3 = kept
    if parity == ODD:
        # An odd function is zero at zero, where only the first function is not.
        weight = math.copysign(weight, x) if x != 0.0 else 0.0
        first -= 1
        if first >= 0:
            out[first, row] += weight * b0
    else:
        out[first, row] += weight * b0
    out[first + 1, row] += weight * b1
    out[first + 2, row] += weight * b2
    out[first + 3, row] += weight * b3
