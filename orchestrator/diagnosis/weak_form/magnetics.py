"""Magnetics as one scalar function: psi = grad W(i), L = Hess W(i), W a tensor B-spline, even in i_q.

Reciprocity (L_dq = L_qd) and parity then hold by construction. W is linear in its coefficients, so a weak-form equation
is linear in them too. The splines are quintic, so that L is three times differentiable; how many intervals, the fit
decides. Units: A, Wb, H, J. The idea of one energy function for a saturated machine: Jebai, Combes, Malrait, Martin,
Rouchon, "Energy-based modeling of electric motors", CDC 2014.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.numerics.tensor_spline import EvenSpline, derivatives
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Magnetics:
    """A co-energy W(i) on a grid of currents.

    Attributes
    ----------
    grid : EvenSpline
        Over i_d and i_q [A].
    coefficients : array, shape (grid.size,)
        [J].
    """

    grid: EvenSpline
    coefficients: Array

    def flux_and_inductance(self, i_dq: Array) -> tuple[Array, Array]:
        """psi (n, 2) [Wb], without the magnet's own, and (L_dd, L_dq, L_qq) (n, 3) [H] at currents (n, 2) [A].

        Beyond the grid's rectangle the flux goes on linearly.
        """
        return derivatives(np.ascontiguousarray(i_dq, dtype=np.float64), self.patches, self.grid.layout[0])

    @cached_property
    def patches(self) -> Array:
        """W as polynomials, one a cell: see `EvenSpline.patches`."""
        return self.grid.patches(self.coefficients)

    def on(self, grid: EvenSpline) -> Magnetics:
        """The same co-energy on another grid; beyond its own the flux goes on linearly."""
        return Magnetics(grid, self.grid.on(grid, self.coefficients))


def linear_magnetics(grid: EvenSpline, l_d_h: float, l_q_h: float) -> Magnetics:
    """Constant inductances: W = L_d i_d^2 / 2 + L_q i_q^2 / 2, exactly, in the spline basis."""
    d_squared, q_squared = grid.squares()
    return Magnetics(grid, 0.5 * l_d_h * d_squared + 0.5 * l_q_h * q_squared)


def smoothness_prior(grid: EvenSpline, inductance_h: float, current_a: float, strength: float) -> Array:
    """Rows of a weak prior on fourth derivatives of W, each with unit variance, shape (rows, grid.size).

    Where no current was measured, the map then goes on as smoothly as what was. The standard deviation of a fourth
    derivative is `strength` * L / I^2: saturation that bends L by as much as itself over the range I is nothing
    unusual.
    """
    sigma = strength * inductance_h / current_a**2
    # As much information as 25 independent derivatives of each kind, however fine the grid.
    blocks = [rows / (sigma * max(math.sqrt(len(rows) / 25.0), 1.0)) for rows in grid.differences(4)]
    # A constant is nothing: held near zero.
    blocks.append(np.eye(grid.size) / (1e3 * inductance_h * current_a**2))
    return np.asarray(np.concatenate(blocks), dtype=np.float64)


def magnet_prior(grid: EvenSpline, std_wb: float) -> Array:
    """The row of a prior on psi_d without current, beside the magnet's own, shape (1, grid.size).

    It is invisible while the rotor stands; one that twists by nothing at all would make of it as much as is wanted.
    """
    return grid.rows(np.clip(np.zeros((1, 2)), [grid.low, 0.0], [grid.high, 0.0]), 1, 0) / std_wb
