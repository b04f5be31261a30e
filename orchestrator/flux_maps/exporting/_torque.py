"""Torque and saliency of a flux map, MTPA and MTPV trajectories; knows no limits of a drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.flux_maps import WHERE, MapSurface
from orchestrator.flux_maps.exporting._inverse import currents_at
from orchestrator.numerics.saliency import Saliency, principal
from orchestrator.numerics.types import Array
from protocols import FluxMap, InputError


@dataclass(frozen=True)
class Trajectory:
    """Working points of maximum torque, one for each magnitude; rows without measured points are NaN."""

    magnitude: Array
    """|i| [A] of an MTPA, |psi| [Wb] of an MTPV, increasing, shape (n,)."""
    i_dq: Array
    """[A], shape (n, 2)."""
    psi_dq: Array
    """[Wb], shape (n, 2)."""
    torque_nm: Array
    """Shape (n,)."""
    interior: NDArray[np.bool_]
    """Whether the maximum torque lies inside the measured region and not at its edge, where more may be possible."""


def torque_nm(flux_map: FluxMap, pole_pairs: int) -> Array:
    """Torque map T = 3/2 n (psi_d i_q - psi_q i_d) of peak-valued vectors [Nm], shape (d, q)."""
    i_d, i_q = (np.asarray(axis, dtype=np.float64) for axis in (flux_map.i_d, flux_map.i_q))
    torque: Array = 1.5 * pole_pairs * (flux_map.psi_d * i_q[None, :] - flux_map.psi_q * i_d[:, None])
    return torque


def saliency(flux_map: FluxMap) -> Saliency:
    """Saliency on a map's grid, shape (d, q); NaN where not measured."""
    return principal(*(np.asarray(table, dtype=np.float64) for table in (flux_map.l_dd, flux_map.l_dq, flux_map.l_qq)))


def mtpa(flux_map: FluxMap, pole_pairs: int, currents_a: Array | None = None) -> Trajectory:
    """Maximum torque per ampere, with i_q >= 0: the greatest torque on each circle |i| = I in the measured region.

    Parameters
    ----------
    flux_map : FluxMap
    pole_pairs : int
    currents_a : array, shape (n,), optional
        Magnitudes [A peak]; by default 41 from zero to the largest measured one.

    Raises
    ------
    InputError
        Where the map cannot be interpolated, or has no point with i_q > 0.
    """
    surface = _motoring(flux_map)
    measured = np.linalg.norm(surface.currents[surface.currents[:, 1] >= 0], axis=1)
    radii = np.linspace(0.0, float(measured.max()), 41) if currents_a is None else currents_a

    def working_point(i_dq: Array) -> tuple[Array, Array]:
        return np.where(surface.inside(i_dq)[:, None], i_dq, np.nan), surface.psi(i_dq)

    return _best(radii, working_point, pole_pairs)


def mtpv(flux_map: FluxMap, pole_pairs: int, fluxes_wb: Array | None = None) -> Trajectory:
    """Maximum torque per volt, with psi_q >= 0: the greatest torque on each circle |psi| = const.

    At a speed where |v| is about omega |psi| (R_s i left out) this is the most that a voltage allows. Where the
    centre of the flux circles was not measured, the small circles have no interior point: see `interior`.

    Parameters
    ----------
    flux_map : FluxMap
    pole_pairs : int
    fluxes_wb : array, shape (n,), optional
        Magnitudes [Wb peak]; by default 41 from the smallest to the largest measured one.

    Raises
    ------
    InputError
        Where the map cannot be interpolated, or has no point with i_q > 0.
    """
    surface = _motoring(flux_map)
    measured = np.linalg.norm(surface.fluxes[surface.currents[:, 1] >= 0], axis=1)
    radii = np.linspace(float(measured.min()), float(measured.max()), 41) if fluxes_wb is None else fluxes_wb
    return _best(radii, lambda psi_dq: (currents_at(surface, psi_dq), psi_dq), pole_pairs)


def _motoring(flux_map: FluxMap) -> MapSurface:
    surface = MapSurface(flux_map)
    if not (surface.currents[:, 1] > 0).any():
        raise InputError(WHERE, "i_q", "no measured point with i_q > 0: no torque curves")
    return surface


def _best(
    radii: Array,
    working_point: Callable[[Array], tuple[Array, Array]],
    pole_pairs: int,
    directions: int = 121,
    rounds: int = 8,
) -> Trajectory:
    """Scan each half circle in so many directions, then zoom in on the greatest torque, four times finer each round."""

    def at(angles: Array) -> tuple[Array, Array, Array]:
        vectors = radii[:, None, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        i_dq, psi_dq = working_point(vectors.reshape(-1, 2))
        torque = 1.5 * pole_pairs * (psi_dq[:, 0] * i_dq[:, 1] - psi_dq[:, 1] * i_dq[:, 0])
        shape = vectors.shape
        return i_dq.reshape(shape), psi_dq.reshape(shape), torque.reshape(shape[:2])

    rows = np.arange(len(radii))
    angles = np.tile(np.linspace(0.0, np.pi, directions), (len(radii), 1))
    for round_ in range(rounds + 1):
        i_dq, psi_dq, torque = at(angles)
        measured = np.isfinite(torque)
        best = np.argmax(np.where(measured, torque, -np.inf), axis=1)
        step = angles[:, 1] - angles[:, 0]
        if round_ < rounds:
            around = np.linspace(-1.0, 1.0, 9)[None, :] * step[:, None]
            angles = np.clip(angles[rows, best][:, None] + around, 0.0, np.pi)
    last = angles.shape[1] - 1
    sides = np.stack((np.clip(best - 1, 0, last), np.clip(best + 1, 0, last)))
    interior = (best > 0) & (best < last) & measured[rows, sides].all(axis=0) & measured[rows, best]
    interior |= (radii == 0.0) & measured[rows, best]
    out_i, out_psi, out_torque = i_dq[rows, best], psi_dq[rows, best], torque[rows, best]
    out_psi = np.where(np.isfinite(out_torque)[:, None], out_psi, np.nan)
    return Trajectory(radii, out_i, out_psi, out_torque, interior)
