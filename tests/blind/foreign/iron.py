"""Magnetic energy of a locked machine as a table over the flux: i = grad H(psi), reciprocal by construction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, np.dtype[np.float64]]

POINTS = 401
"""Of the table on each axis."""
NEWTON_STEPS, COENERGY_STEPS = 60, 25


@njit(cache=True, nogil=True)
def _cubic(t: float) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Four uniform cubic B-splines at t in [0, 1], and their first and second derivatives."""
    r = 1.0 - t
    value = (r * r * r / 6, 2 / 3 - t * t + 0.5 * t * t * t, 2 / 3 - r * r + 0.5 * r * r * r, t * t * t / 6)
    slope = (-0.5 * r * r, 1.5 * t * t - 2 * t, 2 * r - 1.5 * r * r, 0.5 * t * t)
    return value, slope, (r, 3 * t - 2, 3 * r - 2, t)


@njit(cache=True, nogil=True)
def derivatives(c: Array, grid: Array, psi_d: float, psi_q: float) -> tuple[float, float, float, float, float]:
    """i_d, i_q [A] and the Hessian G_dd, G_dq, G_qq [1/H] of the tabulated energy.

    Parameters
    ----------
    grid : array (4,)
        Lowest flux on d and q [Wb], points per Wb on d and q.
    """
    u, v = (psi_d - grid[0]) * grid[2], (psi_q - grid[1]) * grid[3]
    j = min(max(int(u), 1), c.shape[0] - 3)
    k = min(max(int(v), 1), c.shape[1] - 3)
    a, a1, a2 = _cubic(u - j)
    b, b1, b2 = _cubic(v - k)
    h_d = h_q = h_dd = h_dq = h_qq = 0.0
    for m in range(4):
        x0 = x1 = x2 = 0.0
        for n in range(4):
            value = c[j - 1 + m, k - 1 + n]
            x0 += value * b[n]
            x1 += value * b1[n]
            x2 += value * b2[n]
        h_d += a1[m] * x0
        h_q += a[m] * x1
        h_dd += a2[m] * x0
        h_dq += a1[m] * x1
        h_qq += a[m] * x2
    return h_d * grid[2], h_q * grid[3], h_dd * grid[2] ** 2, h_dq * grid[2] * grid[3], h_qq * grid[3] ** 2


@njit(cache=True, nogil=True)
def flux_of(c: Array, grid: Array, i_d: float, i_q: float, psi_d: float, psi_q: float) -> tuple[float, float]:
    """Flux [Wb] at a current by damped Newton steps from a first guess."""
    for _ in range(NEWTON_STEPS):
        d, q, dd, dq, qq = derivatives(c, grid, psi_d, psi_q)
        off_d, off_q = i_d - d, i_q - q
        determinant = dd * qq - dq * dq
        step_d, step_q = (qq * off_d - dq * off_q) / determinant, (dd * off_q - dq * off_d) / determinant
        # Beyond its edge the table is no iron: a step never leaves a tenth of it.
        longest = 0.1 * min((c.shape[0] - 3) / grid[2], (c.shape[1] - 3) / grid[3])
        length = np.hypot(step_d, step_q)
        part = 1.0 if length <= longest else longest / length
        psi_d += part * step_d
        psi_q += part * step_q
        if length < 1e-13:
            break
    return psi_d, psi_q


@dataclass(frozen=True)
class Iron:
    """H(psi) [J] as coefficients of bicubic B-splines, and the grid as in `derivatives`."""

    coefficients: Array
    grid: Array

    def current(self, psi_d: float, psi_q: float) -> tuple[float, float]:
        """i(psi) [A]."""
        return derivatives(self.coefficients, self.grid, psi_d, psi_q)[:2]

    def flux(self, i_d: float, i_q: float) -> tuple[float, float]:
        """psi(i) [Wb]."""
        middle = self.grid[:2] + 0.5 * (np.array(self.coefficients.shape) - 1) / self.grid[2:]
        found: tuple[float, float] = flux_of(self.coefficients, self.grid, i_d, i_q, float(middle[0]), float(middle[1]))
        return found

    def inductance(self, i_d: float, i_q: float) -> tuple[float, float, float]:
        """L_dd, L_dq, L_qq [H] at a current."""
        _, _, dd, dq, qq = derivatives(self.coefficients, self.grid, *self.flux(i_d, i_q))
        determinant = dd * qq - dq * dq
        return qq / determinant, -dq / determinant, dd / determinant

    def scaled(self, flux: float, current: float) -> Iron:
        """The same iron with another number of turns or length: fluxes and currents times these factors."""
        grid = self.grid * np.array([flux, flux, 1 / flux, 1 / flux])
        return Iron(self.coefficients * flux * current, grid)


def tabulated(
    energy: Callable[[Array, Array], Array], d_wb: tuple[float, float], q_wb: float, points: int = POINTS
) -> Iron:
    """The table of H(psi_d, psi_q) [J] over psi_d in `d_wb` and |psi_q| <= q_wb."""
    from scipy.ndimage import spline_filter

    x, y = np.linspace(*d_wb, points), np.linspace(-q_wb, q_wb, points)
    values = energy(*np.meshgrid(x, y, indexing="ij"))
    grid = np.array([x[0], y[0], 1 / (x[1] - x[0]), 1 / (y[1] - y[0])])
    return Iron(np.ascontiguousarray(spline_filter(values, order=3, output=np.float64, mode="mirror")), grid)


def from_coenergy(
    coenergy: Callable[[Array, Array, int, int], Array], d_wb: tuple[float, float], q_wb: float, longest_a: float,
    points: int = POINTS,
) -> Iron:  # fmt: skip
    """The table of H = psi . i - W', where psi = grad W'(i) is solved for i.

    Parameters
    ----------
    coenergy : callable
        Derivative of W' [J] by i_d and i_q of the orders given last, at currents of one shape.
    longest_a : float
        The longest Newton step.
    """

    def energy(psi_d: Array, psi_q: Array) -> Array:
        i_d, i_q = np.zeros_like(psi_d), np.zeros_like(psi_q)
        for _ in range(COENERGY_STEPS):
            off_d, off_q = psi_d - coenergy(i_d, i_q, 1, 0), psi_q - coenergy(i_d, i_q, 0, 1)
            dd, dq, qq = coenergy(i_d, i_q, 2, 0), coenergy(i_d, i_q, 1, 1), coenergy(i_d, i_q, 0, 2)
            determinant = dd * qq - dq * dq
            step_d, step_q = (qq * off_d - dq * off_q) / determinant, (dd * off_q - dq * off_d) / determinant
            length = np.hypot(step_d, step_q)
            part = np.minimum(1.0, longest_a / np.maximum(length, 1e-12))
            i_d, i_q = i_d + part * step_d, i_q + part * step_q
            if length.max() < 1e-9 * longest_a:
                break
        return np.asarray(psi_d * i_d + psi_q * i_q - coenergy(i_d, i_q, 0, 0))

    return tabulated(energy, d_wb, q_wb, points)
