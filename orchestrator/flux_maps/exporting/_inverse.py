"""Currents from flux linkages over the whole measured region; NaN wherever nothing was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.flux_maps import MapSurface, fill_smoothly
from orchestrator.numerics.types import Array, Mask
from protocols import FluxMap


@dataclass(frozen=True)
class InverseMap:
    """Current against flux linkage on a rectangular grid over all measured fluxes; NaN where not measured."""

    psi_d: Array
    """[Wb], increasing, shape (d,)."""
    psi_q: Array
    i_d: Array
    """[A], shape (d, q)."""
    i_q: Array
    coverage_percent: float
    """Share of the flux map's measured points that the inversion reproduces."""
    misfit_wb: float
    """Largest |psi(i(psi)) - psi| at the measured nodes."""

    @property
    def measured(self) -> Mask:
        """Mask of measured nodes, shape (d, q)."""
        mask: Mask = np.isfinite(self.i_d)
        return mask

    def filled(self) -> tuple[Array, Array]:
        """i_d and i_q with the rest of the rectangle continued by least curvature (see `fill_smoothly`)."""
        i_d, i_q = (fill_smoothly(self.psi_d, self.psi_q, table, "inverse map") for table in (self.i_d, self.i_q))
        return i_d, i_q


def invert(flux_map: FluxMap, nodes: int = 51) -> InverseMap:
    """Invert a flux map over its whole measured region.

    Newton on the smooth psi(i) through the map's points, started from the measured point whose flux is nearest; a
    node counts where it converges to a current inside the measured region. The grid spans the bounding box of the
    measured fluxes, not only the rectangle that fits inside them.

    Parameters
    ----------
    flux_map : FluxMap
    nodes : int
        Number of nodes of each axis.

    Raises
    ------
    InputError
        Where the map cannot be interpolated.
    """
    surface = MapSurface(flux_map)
    fluxes = surface.fluxes
    low, high = fluxes.min(axis=0), fluxes.max(axis=0)
    psi_d, psi_q = (np.linspace(low[k], high[k], nodes) for k in (0, 1))
    grid = np.stack(np.meshgrid(psi_d, psi_q, indexing="ij"), axis=-1).reshape(-1, 2)
    currents = currents_at(surface, grid)
    measured = np.isfinite(currents[:, 0])
    misfit = np.linalg.norm(surface.psi(currents[measured]) - grid[measured], axis=1)
    i_d, i_q = currents.T.reshape(2, nodes, nodes)
    return InverseMap(
        psi_d, psi_q, i_d, i_q, coverage_percent=_coverage(surface), misfit_wb=float(misfit.max(initial=0.0))
    )


def currents_at(surface: MapSurface, psi_dq: Array) -> Array:
    """Currents with the given flux linkages, both of shape (n, 2); NaN outside the measured region."""
    from scipy.spatial import cKDTree

    known_i, known_psi = surface.currents, surface.fluxes
    starts = np.asarray(cKDTree(known_psi).query(psi_dq, k=min(3, len(known_psi)))[1])
    currents = np.full(psi_dq.shape, np.nan)
    for attempt in range(starts.shape[1]):
        open_ = np.flatnonzero(np.isnan(currents[:, 0]))
        if open_.size:
            currents[open_] = _newton(surface, psi_dq[open_], known_i[starts[open_, attempt]])
    converged = np.flatnonzero(np.isfinite(currents[:, 0]))
    currents[converged[~surface.inside(currents[converged])]] = np.nan
    return currents


def _newton(surface: MapSurface, psi_dq: Array, start: Array) -> Array:
    """Damped Newton, all points at once; NaN where it does not converge."""
    reach = np.array([np.ptp(surface.i_d), np.ptp(surface.i_q)])
    tolerance = 1e-11 * float(np.ptp(surface.fluxes, axis=0).max())
    i_dq, step_size = start.copy(), np.ones(len(start))
    residual = surface.psi(i_dq) - psi_dq
    for _ in range(60):
        active = np.flatnonzero((np.linalg.norm(residual, axis=1) > tolerance) & (step_size > 1e-4))
        if not active.size:
            break
        step = _solve(surface.jacobian(i_dq[active]), residual[active])
        step *= np.minimum(1.0, 0.2 / np.maximum(np.abs(step / reach).max(axis=1), 1e-300))[:, None]
        trial = i_dq[active] - step_size[active, None] * step
        after = surface.psi(trial) - psi_dq[active]
        better = np.linalg.norm(after, axis=1) < np.linalg.norm(residual[active], axis=1)
        kept = active[better]
        i_dq[kept], residual[kept] = trial[better], after[better]
        step_size[kept] = np.minimum(1.0, 2.0 * step_size[kept])
        step_size[active[~better]] *= 0.5
    # Rounding may keep the residual slightly above the tolerance, which is far below any measurement.
    i_dq[np.linalg.norm(residual, axis=1) > 1e3 * tolerance] = np.nan
    return i_dq


def _solve(matrix: Array, right: Array) -> Array:
    """Solutions of 2 x 2 systems, shapes (n, 2, 2) and (n, 2); zero where the matrix is singular."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    determinant = a * d - b * c
    regular = np.abs(determinant) > 1e-12 * (a * a + d * d)
    over = np.where(regular, 1.0 / np.where(regular, determinant, 1.0), 0.0)
    return np.column_stack((d * right[:, 0] - b * right[:, 1], a * right[:, 1] - c * right[:, 0])) * over[:, None]


def _coverage(surface: MapSurface) -> float:
    back = currents_at(surface, surface.fluxes)
    reach = max(np.ptp(surface.i_d), np.ptp(surface.i_q))
    returned = np.linalg.norm(back - surface.currents, axis=1) < 1e-6 * reach
    return 100.0 * float(returned.mean())
