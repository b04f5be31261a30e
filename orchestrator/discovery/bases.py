"""Flexible laws of a quantity, linear in their coefficients: a curve, a spectrum of lags, and a sum of plays.

The coefficients c are random with a precision K / tau^2, whose K penalises the curve's second differences (a P-spline;
P. H. C. Eilers, B. D. Marx, Stat. Sci. 11 (1996) 89, doi:10.1214/ss/1038425655) and, weakly, its size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csc_array

from orchestrator.discovery.memory import lagged, play
from orchestrator.numerics.types import Array
from protocols import SignalBatch

DEGREE: int = 3
RIDGE: float = 0.05
"""Precision of a coefficient's size, relative to that of its second differences."""
KNEE: float = 0.03
"""Part of a signed quantity's range below which knots are even; beyond, they are spaced geometrically."""

Parity = Literal["odd", "even", "none"]


class Basis(Protocol):
    """Columns of a flexible law."""

    @property
    def size(self) -> int:
        """Number of coefficients."""
        ...

    @property
    def kind(self) -> str: ...

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array | csc_array:
        """Columns over the samples of x (n, m), shape (n m, size); over each interval's `mean` or at its start."""
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

    def design(self, x: Array) -> csc_array:
        """Values of all functions at x (n,), shape (n, size); constant beyond the range."""
        place = np.abs(x) if self.parity != "none" else x
        u = np.clip(self._warped(place), self.knots[0], self.knots[-1])
        whole = csc_array(BSpline.design_matrix(u, self.knots, DEGREE))
        if self.parity != "odd":
            return whole
        # An odd function is zero at zero, where only the first function is not.
        odd, signs = csc_array(whole[:, 1:]), np.sign(x)
        return csc_array((odd.data * signs[odd.indices], odd.indices, odd.indptr), shape=odd.shape)

    def grid(self, points: int) -> Array:
        """Values of x over the range, evenly in the warped coordinate."""
        u = np.linspace(self.knots[0], self.knots[-1], points)
        return u if np.isinf(self.knee) else np.asarray(self.knee * np.sinh(u), dtype=np.float64)

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> csc_array:
        if not mean:
            return self.design(x.ravel())
        # Simpson's rule over the interval after each sample; nothing follows a segment's last one.
        after = np.roll(x, -1, axis=0)
        last = batch.starts[1:] - 1
        after[last] = x[last]
        ends = self.design(x.ravel()) + self.design(after.ravel())
        return csc_array((ends + 4.0 * self.design(0.5 * (x + after).ravel())) / 6.0)

    def _warped(self, x: Array) -> Array:
        return x if np.isinf(self.knee) else np.arcsinh(x / self.knee)


@dataclass(frozen=True)
class MemoryBasis:
    """x less its lag of several time constants, or less its play of several radii.

    Attributes
    ----------
    kind : {"lag", "play"}
    values : tuple of float
        Time constants [s], or radii in the unit of x.
    """

    kind: str
    values: tuple[float, ...]

    @property
    def size(self) -> int:
        return len(self.values)

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        follow = lagged if self.kind == "lag" else play
        out = np.empty((x.size, self.size))
        last = batch.starts[1:] - 1
        for j, value in enumerate(self.values):
            y = x - follow(x, value, batch)
            if mean:
                after = np.roll(y, -1, axis=0)
                after[last] = y[last]
                y = 0.5 * (y + after)
            out[:, j] = y.ravel()
        return out


def penalty(basis: Basis) -> Array:
    """K, shape (size, size)."""
    bend = np.diff(np.eye(basis.size), 2, axis=0)
    return bend.T @ bend + RIDGE * np.eye(basis.size) if basis.kind == "curve" else np.eye(basis.size)
