"""A function of two variables as a tensor product of B-splines, even in the second; knows no physics.

Quintic: the size of its fifth derivatives, which are still functions, is its roughness.
"""

from __future__ import annotations

from functools import cached_property
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.numerics.types import Array

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


_DEGREE = 5
_ROUGHNESS_ORDER = 5


class EvenSpline:
    """Basis on a rectangle [low, high] x [-reach, reach], linear in `size` coefficients.

    Parameters
    ----------
    low, high, reach : float
    cells : (int, int)
        Intervals along the first variable, and over the whole of the second.
    """

    def __init__(self, low: float, high: float, reach: float, cells: tuple[int, int]) -> None:
        self._first = _basis(low, high, cells[0])
        self._second = _basis(-reach, reach, cells[1])
        n = cells[1] + _DEGREE
        # f(y) = f(-y): the coefficients at both ends are one and the same.
        self._fold = (np.eye(n) + np.eye(n)[::-1])[:, : (n + 1) // 2]
        if n % 2:
            self._fold[:, -1] *= 0.5
        self._scale = (0.5 * (high - low), reach)
        self._low, self._high, self._reach = low, high, reach
        self.size = (cells[0] + _DEGREE) * self._fold.shape[1]

    def rows(self, at: Array, along_first: int, along_second: int) -> Array:
        """The basis' mixed derivative at places of shape (m, 2), shape (m, size)."""
        a = self._first.derivative(along_first)(at[:, 0]) if along_first else self._first(at[:, 0])
        b = self._second.derivative(along_second)(at[:, 1]) if along_second else self._second(at[:, 1])
        out: Array = np.einsum("mi,mj->mij", a, b @ self._fold).reshape(len(at), self.size)
        return out

    @cached_property
    def roughness(self) -> Array:
        """Matrix of the integral of all squared fifth derivatives, in units of the half ranges; (size, size)."""
        firsts = _squares(self._first, self._low, self._high, self._scale[0])
        seconds = _squares(self._second, -self._reach, self._reach, self._scale[1])
        out = np.zeros((self.size, self.size))
        for k in range(_ROUGHNESS_ORDER + 1):
            other = self._fold.T @ seconds[_ROUGHNESS_ORDER - k] @ self._fold
            out += comb(_ROUGHNESS_ORDER, k) * np.kron(firsts[k], other)
        return out

    @property
    def smooth(self) -> int:
        """Dimension of what has no roughness: even polynomials of the fourth degree."""
        return sum(_ROUGHNESS_ORDER - k for k in range(0, _ROUGHNESS_ORDER, 2))

    @cached_property
    def modes(self) -> Array:
        """Coefficients of all functions in another basis, shape (size, size), one mode a column.

        First come `smooth` polynomials, by degree: the constant, the first variable, its square, the second's square
        and so on, in units of the half ranges. The others are orthogonal to them (as coefficients), and the sum of
        their squares is the roughness.
        """
        smooth = self._polynomials()
        rest = np.linalg.qr(smooth, mode="complete")[0][:, self.smooth :]
        root = np.linalg.cholesky(rest.T @ self.roughness @ rest)
        return np.concatenate([smooth, np.linalg.solve(root, rest.T).T], axis=1)

    def _polynomials(self) -> Array:
        d = np.linspace(self._low, self._high, 3 * _DEGREE + len(self._first.c))
        q = np.linspace(0.0, self._reach, 3 * _DEGREE + len(self._second.c))
        at = np.stack(np.meshgrid(d, q, indexing="ij"), axis=-1).reshape(-1, 2)
        x, y = (2.0 * at[:, 0] - self._low - self._high) / (self._high - self._low), at[:, 1] / self._reach
        degrees = [(n - k, k) for n in range(_ROUGHNESS_ORDER) for k in range(0, n + 1, 2)]
        values = np.stack([x**m * y**n for m, n in degrees], axis=1)
        return np.asarray(np.linalg.lstsq(self.rows(at, 0, 0), values, rcond=None)[0])


def _basis(low: float, high: float, cells: int) -> BSpline:
    from scipy.interpolate import BSpline

    step = (high - low) / cells
    knots = low + step * np.arange(-_DEGREE, cells + _DEGREE + 1)
    return BSpline(knots, np.eye(cells + _DEGREE), _DEGREE)


def _squares(basis: BSpline, low: float, high: float, scale: float) -> list[Array]:
    """Integrals of products of the m-th derivatives, m = 0 to 5, exact by Gauss' rule in each interval."""
    nodes, weights = np.polynomial.legendre.leggauss(_DEGREE + 1)
    edges = basis.t[(basis.t >= low - 1e-9 * scale) & (basis.t <= high + 1e-9 * scale)]
    half = 0.5 * np.diff(edges)
    at = (0.5 * (edges[1:] + edges[:-1]))[:, None] + half[:, None] * nodes
    weight = (half[:, None] * weights).ravel() / scale
    out = []
    for m in range(_ROUGHNESS_ORDER + 1):
        values = (basis.derivative(m) if m else basis)(at.ravel()) * scale**m
        out.append(np.asarray((values * weight[:, None]).T @ values))
    return out
