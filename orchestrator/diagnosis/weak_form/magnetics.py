"""Magnetics as one scalar function: psi = grad W(i), L = Hess W(i), W a tensor B-spline, even in i_q.

Reciprocity (L_dq = L_qd) and parity then hold by construction. W is linear in its coefficients, so
a weak-form equation is linear in them too. The splines are quintic on uniform knots, so that L is
three times differentiable; how many intervals, the fit decides. Units: A, Wb, H, J. The idea of
one energy function for a saturated machine: Jebai, Combes, Malrait, Martin, Rouchon, "Energy-based
modeling of electric motors", CDC 2014.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

DEGREE = 5
_SUPPORT = DEGREE + 1


def _pieces() -> Array:
    """Coefficients of the cardinal quintic: piece[r, p] of t^p for the basis function r of an interval."""
    pieces = np.zeros((_SUPPORT, _SUPPORT))
    for r in range(_SUPPORT):
        # Basis function r of interval m is N(t + DEGREE - r), N the cardinal spline on [0, DEGREE + 1].
        shift = DEGREE - r
        for j in range(shift + 1):
            factor = (-1) ** j * math.comb(_SUPPORT, j) / math.factorial(DEGREE)
            for p in range(_SUPPORT):
                pieces[r, p] += factor * math.comb(DEGREE, p) * float(shift - j) ** (DEGREE - p)
    return pieces


PIECES = _pieces()


@dataclass(frozen=True)
class SplineGrid:
    """Uniform knots over a rectangle of currents, symmetric in i_q.

    Attributes
    ----------
    d_low, d_high : float
        Range of i_d [A].
    q_high : float
        Range of i_q is -q_high..q_high [A].
    d_intervals, q_intervals : int
    """

    d_low: float
    d_high: float
    q_high: float
    d_intervals: int
    q_intervals: int

    @property
    def d_step(self) -> float:
        return (self.d_high - self.d_low) / self.d_intervals

    @property
    def q_step(self) -> float:
        return 2.0 * self.q_high / self.q_intervals

    @property
    def d_functions(self) -> int:
        return self.d_intervals + DEGREE

    @property
    def q_functions(self) -> int:
        """Of the even functions of i_q."""
        return (self.q_intervals + DEGREE + 1) // 2

    @property
    def coefficients(self) -> int:
        return self.d_functions * self.q_functions

    @property
    def layout(self) -> tuple[Array, NDArray[np.int64]]:
        """What the kernels take: (d_low, d_step, -q_high, q_step) and (d_intervals, q_intervals, folding...)."""
        numbers = np.array([self.d_low, self.d_step, -self.q_high, self.q_step])
        return numbers, np.array([self.d_intervals, self.q_intervals, *self.fold], dtype=np.int64)

    @property
    def fold(self) -> list[int]:
        """Which even function of i_q each spline along i_q belongs to."""
        full = self.q_intervals + DEGREE
        return [min(j, full - 1 - j) for j in range(full)]

    def roughness(self, inductance_h: float, current_a: float, strength: float) -> Array:
        """Rows of a weak prior on fourth derivatives of W, each with unit variance.

        Where no current was measured, the map then goes on as smoothly as what was. The standard
        deviation of a fourth derivative is `strength` * L / I^2: saturation that bends L by as much
        as itself over the range I is nothing unusual.
        """
        nd, nq = self.d_functions, self.q_functions
        full = self.q_intervals + DEGREE
        unfold = np.zeros((full, nq))
        unfold[np.arange(full), [min(j, full - 1 - j) for j in range(full)]] = 1.0
        sigma = strength * inductance_h / current_a**2
        blocks = []
        for order_d, times in ((4, 1.0), (3, 2.0), (2, math.sqrt(6.0)), (1, 2.0), (0, 1.0)):
            order_q = 4 - order_d
            if nd <= order_d or full <= order_q:
                continue
            along_d = np.diff(np.eye(nd), n=order_d, axis=0) / self.d_step**order_d
            along_q = np.diff(np.eye(full), n=order_q, axis=0) @ unfold / self.q_step**order_q
            cells = math.sqrt(along_d.shape[0] * along_q.shape[0] / 25.0)
            blocks.append(times * np.kron(along_d, along_q) / (sigma * max(cells, 1.0)))
        # Constants, and the magnet's own flux, are invisible to a locked rotor: held near zero.
        blocks.append(np.eye(nd * nq) / (1e3 * inductance_h * current_a**2))
        return np.asarray(np.concatenate(blocks), dtype=np.float64)


@dataclass(frozen=True)
class Magnetics:
    """A co-energy W(i) on a grid.

    Attributes
    ----------
    grid : SplineGrid
    coefficients : array, shape (grid.coefficients,)
        [J].
    """

    grid: SplineGrid
    coefficients: Array

    def flux_and_inductance(self, i_dq: Array) -> tuple[Array, Array]:
        """psi (n, 2) [Wb], without the magnet's own, and (L_dd, L_dq, L_qq) (n, 3) [H] at currents (n, 2) [A].

        Beyond the grid's rectangle the flux goes on linearly.
        """
        numbers, _ = self.grid.layout
        return _evaluate(np.ascontiguousarray(i_dq, dtype=np.float64), self.patches, numbers)

    @cached_property
    def patches(self) -> Array:
        """W as polynomials, one a cell: coefficients of t_d^m t_q^n, shape (d_intervals, q_intervals, 6, 6)."""
        grid = self.grid
        c = self.coefficients.reshape(grid.d_functions, grid.q_functions)[:, grid.fold]
        cells = np.lib.stride_tricks.sliding_window_view(c, (_SUPPORT, _SUPPORT))
        return np.ascontiguousarray(np.einsum("rm,abrs,sn->abmn", PIECES, cells, PIECES, optimize=True))


def linear_magnetics(grid: SplineGrid, l_d_h: float, l_q_h: float) -> Magnetics:
    """Constant inductances: W = L_d i_d^2 / 2 + L_q i_q^2 / 2, exactly, in the spline basis."""

    def quadratic(low: float, step: float, functions: int) -> Array:
        # Coefficients of x^2 on uniform knots: Greville abscissa squared minus a constant (blossoming).
        centre = low + step * (np.arange(functions) - (DEGREE - 1) / 2.0)
        return np.asarray(centre**2 - step**2 * (DEGREE + 1) / 12.0, dtype=np.float64)

    full = grid.q_intervals + DEGREE
    d = quadratic(grid.d_low, grid.d_step, grid.d_functions)
    q = quadratic(-grid.q_high, grid.q_step, full)[: grid.q_functions]
    w = 0.5 * l_d_h * d[:, None] + 0.5 * l_q_h * q[None, :]
    return Magnetics(grid, np.asarray(np.ascontiguousarray(w).reshape(-1), dtype=np.float64))


def on_grid(magnetics: Magnetics, grid: SplineGrid) -> Magnetics:
    """The same co-energy on another grid over the same rectangle, by least squares along each axis."""
    old = magnetics.grid
    d = np.linspace(grid.d_low, grid.d_high, 8 * max(old.d_intervals, grid.d_intervals))
    q = np.linspace(-grid.q_high, grid.q_high, 8 * max(old.q_intervals, grid.q_intervals))

    def change(x: Array, low: float, new_step: float, new: int, old_step: float, before: int) -> Array:
        ahead, behind = _values(x, low, new_step, new), _values(x, low, old_step, before)
        return np.asarray(np.linalg.lstsq(ahead, behind, rcond=None)[0])

    along_d = change(d, grid.d_low, grid.d_step, grid.d_intervals, old.d_step, old.d_intervals)
    along_q = change(q, -grid.q_high, grid.q_step, grid.q_intervals, old.q_step, old.q_intervals)
    full = magnetics.coefficients.reshape(old.d_functions, old.q_functions)[:, old.fold]
    moved = (along_d @ full @ along_q.T)[:, : grid.q_functions]
    return Magnetics(grid, np.ascontiguousarray(moved).reshape(-1))


def _values(x: Array, low: float, step: float, intervals: int) -> Array:
    """All splines of one axis at points x, shape (points, intervals + DEGREE)."""
    u = (x - low) / step
    cell = np.clip(np.floor(u).astype(np.int64), 0, intervals - 1)
    powers = (u - cell)[:, None] ** np.arange(_SUPPORT)
    out = np.zeros((len(x), intervals + DEGREE))
    np.put_along_axis(out, cell[:, None] + np.arange(_SUPPORT), powers @ PIECES.T, axis=1)
    return out


@njit(cache=True, nogil=True, inline="always")
def local_flux(x: float, y: float, patches: Array, numbers: Array) -> tuple[float, float, float, float, float]:
    """psi_d, psi_q, L_dd, L_dq, L_qq at one current; beyond the rectangle linear from its edge."""
    u = (x - numbers[0]) / numbers[1]
    v = (y - numbers[2]) / numbers[3]
    m = min(max(int(u), 0), patches.shape[0] - 1)
    n = min(max(int(v), 0), patches.shape[1] - 1)
    s = min(max(u - m, 0.0), 1.0)
    t = min(max(v - n, 0.0), 1.0)
    w1 = 0.0
    w2 = 0.0
    w = 0.0
    b = 0.0
    b1 = 0.0
    c = 0.0
    for r in range(5, -1, -1):
        # Value and two derivatives along q of row r, then the same by Horner along d.
        f = patches[m, n, r, 5]
        g = 0.0
        h = 0.0
        for k in range(4, -1, -1):
            h = h * t + g
            g = g * t + f
            f = f * t + patches[m, n, r, k]
        w2 = w2 * s + w1
        w1 = w1 * s + w
        w = w * s + f
        b1 = b1 * s + b
        b = b * s + g
        c = c * s + 2.0 * h
    l_dd = 2.0 * w2 / (numbers[1] * numbers[1])
    l_dq = b1 / (numbers[1] * numbers[3])
    l_qq = c / (numbers[3] * numbers[3])
    out_d = (u - m - s) * numbers[1]
    out_q = (v - n - t) * numbers[3]
    psi_d = w1 / numbers[1] + l_dd * out_d + l_dq * out_q
    psi_q = b / numbers[3] + l_dq * out_d + l_qq * out_q
    return psi_d, psi_q, l_dd, l_dq, l_qq


@njit(cache=True, nogil=True)
def _evaluate(i_dq: Array, patches: Array, numbers: Array) -> tuple[Array, Array]:
    n = i_dq.shape[0]
    psi = np.empty((n, 2))
    inductance = np.empty((n, 3))
    for k in range(n):
        psi[k, 0], psi[k, 1], inductance[k, 0], inductance[k, 1], inductance[k, 2] = local_flux(
            i_dq[k, 0], i_dq[k, 1], patches, numbers
        )
    return psi, inductance
