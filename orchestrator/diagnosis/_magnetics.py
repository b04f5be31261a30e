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

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
        full = self.q_intervals + DEGREE
        fold = [min(j, full - 1 - j) for j in range(full)]
        numbers = np.array([self.d_low, self.d_step, -self.q_high, self.q_step])
        return numbers, np.array([self.d_intervals, self.q_intervals, *fold], dtype=np.int64)

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
        numbers, counts = self.grid.layout
        return _evaluate(np.ascontiguousarray(i_dq, dtype=np.float64), self.coefficients, numbers, counts, PIECES)


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


@njit(cache=True, nogil=True)
def _functions(x: float, low: float, step: float, intervals: int, pieces: Array, out: Array) -> int:
    """Values, first and second derivatives of the six functions at x -> out (3, 6); returns the first's index."""
    u = (x - low) / step
    m = math.floor(u)
    m = min(max(m, 0), intervals - 1)
    t = u - m
    # Beyond the rectangle: second-order Taylor series from its edge, so that L stays what it is there.
    edge = min(max(t, 0.0), 1.0)
    beyond = t - edge
    for r in range(6):
        v = 0.0
        d1 = 0.0
        d2 = 0.0
        for p in range(5, -1, -1):
            d2 = d2 * edge + 2.0 * d1
            d1 = d1 * edge + v
            v = v * edge + pieces[r, p]
        out[0, r] = v + beyond * (d1 + 0.5 * beyond * d2)
        out[1, r] = (d1 + beyond * d2) / step
        out[2, r] = d2 / (step * step)
    return m


@njit(cache=True, nogil=True)
def _evaluate(i_dq: Array, c: Array, numbers: Array, counts: NDArray[np.int64], pieces: Array) -> tuple[Array, Array]:
    n = i_dq.shape[0]
    nq = (counts.shape[0] - 2 + 1) // 2
    psi = np.zeros((n, 2))
    inductance = np.zeros((n, 3))
    fd = np.empty((3, 6))
    fq = np.empty((3, 6))
    for k in range(n):
        a = _functions(i_dq[k, 0], numbers[0], numbers[1], counts[0], pieces, fd)
        b = _functions(i_dq[k, 1], numbers[2], numbers[3], counts[1], pieces, fq)
        for r in range(6):
            s0 = 0.0
            s1 = 0.0
            s2 = 0.0
            base = (a + r) * nq
            for s in range(6):
                w = c[base + counts[2 + b + s]]
                s0 += w * fq[0, s]
                s1 += w * fq[1, s]
                s2 += w * fq[2, s]
            psi[k, 0] += fd[1, r] * s0
            psi[k, 1] += fd[0, r] * s1
            inductance[k, 0] += fd[2, r] * s0
            inductance[k, 1] += fd[1, r] * s1
            inductance[k, 2] += fd[0, r] * s2
    return psi, inductance


@njit(cache=True, nogil=True)
def sum_basis(
    i_dq: Array,
    delta: Array,
    step: float,
    hats: int,
    bins: NDArray[np.int64],
    n_bins: int,
    numbers: Array,
    counts: NDArray[np.int64],
    pieces: Array,
) -> Array:
    """Weighted sums of -(psi_{k+1} - psi_k), one column a coefficient -> (hats, n_bins, 2, coefficients).

    Parameters
    ----------
    i_dq : array, shape (n, 2)
        Magnetising current in the true rotor frame.
    delta : array, shape (n,) or (0,)
        True minus believed angle; the flux is turned back into the believed frame by it. Empty: zero.
    """
    n = i_dq.shape[0]
    nq = (counts.shape[0] - 2 + 1) // 2
    out = np.zeros((hats, n_bins, 2, (counts[0] + 5) * nq))
    fd = np.empty((3, 6))
    fq = np.empty((3, 6))
    hat = np.empty(6, dtype=np.int64)
    slot = np.empty(6, dtype=np.int64)
    weight = np.empty(6)
    turned = delta.shape[0] > 0
    last_j = 0
    last_w0 = 0.0
    last_w1 = 0.0
    for k in range(n):
        a = _functions(i_dq[k, 0], numbers[0], numbers[1], counts[0], pieces, fd)
        b = _functions(i_dq[k, 1], numbers[2], numbers[3], counts[1], pieces, fq)
        # psi_k enters interval k with +1 and interval k - 1 with -1.
        used = 0
        j = 0
        w0 = 0.0
        w1 = 0.0
        if k < n - 1:
            x = (k + 0.5) / step
            j = math.floor(x) - 1
            w1 = x - math.floor(x)
            w0 = 1.0 - w1
            if j < 0 or j >= hats:
                w0 = 0.0
            if j + 1 >= hats:
                w1 = 0.0
        merge = k > 0 and k < n - 1 and j == last_j and bins[k] == bins[k - 1]
        if merge:
            if w0 != last_w0:
                hat[used], slot[used], weight[used] = j, bins[k], w0 - last_w0
                used += 1
            if w1 != last_w1:
                hat[used], slot[used], weight[used] = j + 1, bins[k], w1 - last_w1
                used += 1
        else:
            if w0 > 0.0:
                hat[used], slot[used], weight[used] = j, bins[k], w0
                used += 1
            if w1 > 0.0:
                hat[used], slot[used], weight[used] = j + 1, bins[k], w1
                used += 1
            if k > 0 and last_w0 > 0.0:
                hat[used], slot[used], weight[used] = last_j, bins[k - 1], -last_w0
                used += 1
            if k > 0 and last_w1 > 0.0:
                hat[used], slot[used], weight[used] = last_j + 1, bins[k - 1], -last_w1
                used += 1
        last_j, last_w0, last_w1 = j, w0, w1
        if used == 0:
            continue
        cos = 1.0
        sin = 0.0
        if turned:
            cos = math.cos(delta[k])
            sin = math.sin(delta[k])
        for r in range(6):
            base = (a + r) * nq
            for s in range(6):
                col = base + counts[2 + b + s]
                pd = fd[1, r] * fq[0, s]
                pq = fd[0, r] * fq[1, s]
                if turned:
                    pd, pq = cos * pd - sin * pq, sin * pd + cos * pq
                for u in range(used):
                    out[hat[u], slot[u], 0, col] += weight[u] * pd
                    out[hat[u], slot[u], 1, col] += weight[u] * pq
    return out
