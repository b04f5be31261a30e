"""Magnetics as one scalar function: psi = grad W(i), L = Hess W(i), W a tensor B-spline, even in i_q.

Reciprocity (L_dq = L_qd) and parity then hold by construction. W is linear in its coefficients, and so are the
weak-form equations. The splines are quintic, so that L is three times differentiable; the fit chooses the number of
intervals. Units: A, Wb, H, J. Source of the energy function for a saturated machine: Jebai, Combes, Malrait, Martin,
Rouchon, "Energy-based modeling of electric motors", CDC 2014.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.numerics.tensor_spline import EvenSpline, derivatives
from orchestrator.numerics.types import Array

KINK_STRENGTH: float = 3.0
"""Prior standard deviation of a kink, the jump of dL_q/di_q at i_q = 0, in units of `strength` L / I.

Saturation over the range is one unit; the L_q of a reluctance machine halves within a tenth of its current, which is 7.
"""


@dataclass(frozen=True)
class Magnetics:
    """A co-energy W(i) on a grid of currents.

    Attributes
    ----------
    grid : EvenSpline
        Spline grid over i_d and i_q [A].
    coefficients : array, shape (grid.size,)
        Coefficients of W [J].
    """

    grid: EvenSpline
    coefficients: Array

    def flux_and_inductance(self, i_dq: Array) -> tuple[Array, Array]:
        """psi (n, 2) [Wb], without the magnet's, and (L_dd, L_dq, L_qq) (n, 3) [H] at currents (n, 2) [A].

        Beyond the grid's rectangle the flux continues linearly.
        """
        return derivatives(np.ascontiguousarray(i_dq, dtype=np.float64), self.patches, self.grid.layout[0])

    @cached_property
    def patches(self) -> Array:
        """W as a polynomial per cell; see `EvenSpline.patches`."""
        return self.grid.patches(self.coefficients)

    def on(self, grid: EvenSpline) -> Magnetics:
        """The co-energy on another grid; beyond the present one the flux continues linearly."""
        return Magnetics(grid, self.grid.on(grid, self.coefficients))


def linear_magnetics(grid: EvenSpline, l_d_h: float, l_q_h: float) -> Magnetics:
    """Constant inductances: W = L_d i_d^2 / 2 + L_q i_q^2 / 2, exactly, in the spline basis."""
    d_squared, q_squared = grid.squares()
    return Magnetics(grid, 0.5 * l_d_h * d_squared + 0.5 * l_q_h * q_squared)


ORDER_OF_SMOOTHNESS: int = 4
"""Order of the derivatives of W that the smoothness prior holds small."""


def shares_of_nodes(places: Array, nodes: tuple[int, ...]) -> Array:
    """Share of each of (m, n) nodes in places (p, 2) from 0 to 1, shape (p, m n); by bilinear interpolation."""
    along = []
    for x, count in zip(places.T, nodes, strict=True):
        distance = np.abs(x[:, None] * (count - 1) - np.arange(count))
        along.append(np.maximum(1.0 - distance, 0.0))
    return np.asarray(np.einsum("pm,pn->pmn", *along).reshape(len(places), -1))


def smoothness_prior(
    grid: EvenSpline, inductance_h: float, current_a: float, strength: float, roughness: Array | None = None
) -> Array:
    """Rows of a weak prior on fourth derivatives of W, each with unit variance, shape (rows, grid.size).

    It extrapolates the map smoothly where no current was measured. The standard deviation of a fourth derivative is
    `strength` * L / I^2: saturation commonly changes L by as much as L over the range I. Rows of derivatives come
    first, in the order of `EvenSpline.differences`.

    Parameters
    ----------
    roughness : array, shape (m, n), optional
        Factors of the standard deviation at m nodes along i_d by n from i_q = 0 outwards, geometric means in between.
    """
    sigma = strength * inductance_h / current_a**2
    # The information of 25 independent derivatives of each kind, for any grid.
    blocks = [rows / (sigma * max(math.sqrt(len(rows) / 25.0), 1.0)) for rows in grid.differences(ORDER_OF_SMOOTHNESS)]
    if roughness is not None:
        shares = shares_of_nodes(grid.difference_places(ORDER_OF_SMOOTHNESS), roughness.shape)
        blocks = [np.concatenate(blocks) / np.exp(shares @ np.log(roughness).reshape(-1))[:, None]]
    if grid.kink:
        # d^3 W/d i_q^3 jumps by 12 times the coefficient over the cube of a step.
        jumps = np.zeros(grid.functions)
        jumps[:, -1] = 12.0 / grid.steps[1] ** 3 / (KINK_STRENGTH * strength * inductance_h / current_a)
        blocks.append(np.diag(jumps.reshape(-1))[jumps.reshape(-1) > 0.0])
    energy_j = inductance_h * current_a**2
    blocks.append(np.eye(grid.size) / (1e3 * energy_j))
    # A constant of W has no effect, but a free one would make the normal matrix singular: W is zero at rest.
    blocks.append(grid.rows(_at_rest(grid), 0, 0) / (1e-3 * energy_j))
    return np.asarray(np.concatenate(blocks), dtype=np.float64)


def magnet_prior(grid: EvenSpline, std_wb: float) -> Array:
    """Row of a prior on psi_d at zero current in addition to the magnet's flux, shape (1, grid.size).

    That flux is unobservable at standstill; with a slightly twisting rotor it would be estimated arbitrarily.
    """
    return grid.rows(_at_rest(grid), 1, 0) / std_wb


def _at_rest(grid: EvenSpline) -> Array:
    """Zero current, or the nearest that is on the grid, shape (1, 2)."""
    return np.clip(np.zeros((1, 2)), [grid.low, 0.0], [grid.high, 0.0])
