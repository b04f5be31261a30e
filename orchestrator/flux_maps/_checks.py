"""Properties of every machine's flux map: reciprocity, parity, convexity, smoothness. Judges nothing.

Motors store energy: psi = grad W(i) with W convex, and even about the magnet's axis. Each check gives a figure, in Wb
where possible, so that a fault compares with the flux and with the map's own error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.flux_maps._surface import WHERE, MapSurface
from orchestrator.numerics.types import Array, Mask
from protocols import InputError

_MIN_SWING_WB, _MAX_SWING_WB = 1e-12, 1e6
"""Range of the flux outside of which a file has zeros or another unit."""
_GAUSS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class Reciprocity:
    """Distance of a map from a gradient."""

    distance_h: float
    """rms of the cells' mean dpsi_d/di_q - dpsi_q/di_d."""
    distance_wb: float
    """rms of the flux's difference from the nearest gradient, along the grid's edges."""


@dataclass(frozen=True)
class Symmetry:
    """Distance of a map from evenness about an axis."""

    axis_rad: float
    """The axis' angle from d."""
    rms_wb: float
    d_wb: float
    """Largest odd part of the flux along the axis."""
    q_wb: float
    """Largest even part of the flux across it."""


def swing_of(surface: MapSurface) -> float:
    """Half the range of psi_d or psi_q, whichever is larger [Wb]; raises `InputError` where that is no motor's."""
    swing = 0.5 * float(np.ptp(surface.fluxes, axis=0).max())
    if not _MIN_SWING_WB < swing < _MAX_SWING_WB:
        raise InputError(WHERE, "psi_d, psi_q", f"a flux range of {swing:.3g} Wb is impossible for a motor")
    return swing


def curl(surface: MapSurface) -> Array:
    """Mean of dpsi_d/di_q - dpsi_q/di_d over each cell [H], shape (d - 1, q - 1), by the circulation of psi around it.

    NaN where a corner was not measured.
    """
    known, along_d, along_q = surface.known, _edge_integrals(surface, 0), _edge_integrals(surface, 1)
    whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    turn = along_d[:, 1:] + along_q[:-1, :] - along_d[:, :-1] - along_q[1:, :]
    return np.where(whole, turn / np.outer(np.diff(surface.i_d), np.diff(surface.i_q)), np.nan)


def reciprocity(surface: MapSurface) -> Reciprocity | None:
    """Distance of psi from a gradient; None where no cell is complete.

    The nearest gradient is the potential on the nodes whose differences come nearest to the integrals of psi along
    the edges.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import lsqr

    per_cell = curl(surface)
    if np.isnan(per_cell).all():
        return None
    known, (n_d, n_q) = surface.known, surface.known.shape
    node = np.arange(known.size).reshape(known.shape)
    starts = np.concatenate([node[:-1].ravel(), node[:, :-1].ravel()])
    ends = np.concatenate([node[1:].ravel(), node[:, 1:].ravel()])
    lengths = np.concatenate([np.repeat(np.diff(surface.i_d), n_q), np.tile(np.diff(surface.i_q), n_d)])
    used = known.ravel()[starts] & known.ravel()[ends]
    integrals = np.concatenate([_edge_integrals(surface, axis).ravel() for axis in (0, 1)])
    means = integrals[used] / lengths[used]
    rows = np.tile(np.arange(used.sum()), 2)
    slopes = np.concatenate([-1.0 / lengths[used], 1.0 / lengths[used]])
    matrix = coo_array((slopes, (rows, np.concatenate([starts[used], ends[used]]))), shape=(used.sum(), known.size))
    solution: Any = lsqr(matrix.tocsr(), means, atol=1e-12, btol=1e-12, iter_lim=10 * known.size)
    return Reciprocity(_rms(per_cell[np.isfinite(per_cell)]), _rms(matrix @ solution[0] - means))


def unevenness(surface: MapSurface, axis_rad: float) -> Array:
    """Half the flux's difference from its mirror image in an axis, along and across it [Wb].

    Of each measured point, shape (k, 2); NaN where the mirror image was not measured.
    """
    c, s = np.cos(2.0 * axis_rad), np.sin(2.0 * axis_rad)
    mirror = np.array([[c, s], [s, -c]])
    images = surface.currents @ mirror
    difference = 0.5 * (surface.psi(images) @ mirror - surface.fluxes)
    difference[~surface.inside(images)] = np.nan
    axes = np.array([[np.cos(axis_rad), -np.sin(axis_rad)], [np.sin(axis_rad), np.cos(axis_rad)]])
    return np.asarray(difference @ axes, dtype=np.float64)


def symmetry(surface: MapSurface, axis_rad: float = 0.0) -> Symmetry | None:
    """Evenness about an axis through the origin; None where no point has its mirror image in the measured region."""
    apart = unevenness(surface, axis_rad)
    apart = apart[np.isfinite(apart[:, 0])]
    if not len(apart):
        return None
    d, q = np.abs(apart).max(axis=0)
    return Symmetry(axis_rad, _rms(np.linalg.norm(apart, axis=1)), float(d), float(q))


def symmetry_axis(surface: MapSurface, near_rad: float, reach_rad: float = np.pi / 12.0) -> Symmetry | None:
    """The axis within `reach_rad` of a first guess about which the map is most nearly even."""
    from scipy.optimize import minimize_scalar

    if symmetry(surface, near_rad) is None:
        return None

    worst = 1e3 * swing_of(surface)  # worse than any axis, and finite for the search

    def unevenness_at(axis_rad: float) -> float:
        result = symmetry(surface, axis_rad)
        return worst if result is None else result.rms_wb

    # A coarse scan first, because the set of points inside the region changes in steps with the axis.
    scan = near_rad + np.linspace(-reach_rad, reach_rad, 31)
    step = scan[1] - scan[0]
    best = min(scan, key=unevenness_at)
    minimum: Any = minimize_scalar(
        unevenness_at, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-6}
    )
    return symmetry(surface, float(minimum.x))


def least_inductances(surface: MapSurface) -> Array:
    """Smaller eigenvalue of the symmetric part of dpsi/di at each measured point [H]: negative is not convex."""
    slopes = surface.jacobian(surface.currents)
    mean, half = 0.5 * (slopes[:, 0, 0] + slopes[:, 1, 1]), 0.5 * (slopes[:, 0, 0] - slopes[:, 1, 1])
    cross = 0.5 * (slopes[:, 0, 1] + slopes[:, 1, 0])
    least: Array = mean - np.hypot(half, cross)
    return least


def magnet_direction(
    surface: MapSurface, swing: float, least_share: float = 0.05
) -> tuple[float | None, float | None, float]:
    """Flux at zero current [Wb], its angle from d, and the nearest quarter turn [rad].

    The first is None where zero current was not measured; a flux below `least_share` of the swing is no magnet's, and
    has neither angle nor quarter.
    """
    rest = np.zeros((1, 2))
    if not surface.inside(rest)[0]:
        return None, None, 0.0
    flux = surface.psi(rest)[0]
    size = float(np.linalg.norm(flux))
    if size <= least_share * swing:
        return size, None, 0.0
    angle = math.atan2(flux[1], flux[0])
    return size, angle, 0.5 * math.pi * round(angle / (0.5 * math.pi))


def enclosed(known: Mask) -> Mask:
    """Unmeasured points that are surrounded by measured ones, unlike those at the grid's edge."""
    from scipy.ndimage import label

    labels, _ = label(~known)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    inner: Mask = ~known & ~np.isin(labels, border)
    return inner


def roughness(surface: MapSurface) -> tuple[Array, Array]:
    """Deviation of each point from the fifth-degree polynomial through its six neighbours along d, and along q.

    It is relative to independent errors of 1 Wb, with its sign; shapes (d, q, 2), the last for psi_d and psi_q. NaN
    where the neighbours were not measured. An error of the point itself shows equally along both axes; a knee that the
    grid does not resolve does not.
    """
    values = np.where(surface.known[..., None], np.stack(surface.filled, axis=-1), np.nan)
    along_d = _against_neighbours(values, surface.i_d)
    along_q = _against_neighbours(values.swapaxes(0, 1), surface.i_q).swapaxes(0, 1)
    return along_d, along_q


def _against_neighbours(values: Array, nodes: Array, beside: int = 3) -> Array:
    out = np.full(values.shape, np.nan)
    for k in range(beside, len(nodes) - beside):
        around = np.r_[k - beside : k, k + 1 : k + beside + 1]
        apart = (nodes[around, None] - nodes[None, around])[~np.eye(2 * beside, dtype=bool)].reshape(2 * beside, -1)
        toward = np.array([np.prod(np.delete(nodes[k] - nodes[around], m)) for m in range(2 * beside)])
        weights = toward / np.prod(apart, axis=1)
        out[k] = (values[k] - np.tensordot(weights, values[around], 1)) / np.sqrt(1.0 + weights @ weights)
    return out


def _edge_integrals(surface: MapSurface, axis: int) -> Array:
    """Integral of psi along each of the grid's edges [Wb A], exact for the surface's cubics."""
    nodes, across = (surface.i_d, surface.i_q) if axis == 0 else (surface.i_q, surface.i_d)
    middle, half = 0.5 * (nodes[1:] + nodes[:-1]), 0.5 * np.diff(nodes)
    at = middle[:, None] + half[:, None] * _GAUSS[0]
    along, beside = np.broadcast_arrays(at[:, :, None], across)
    places = np.stack((along, beside) if axis == 0 else (beside, along), axis=-1).reshape(-1, 2)
    flux = surface.psi(places)[:, axis].reshape(along.shape)
    integrals: Array = np.einsum("k,mkn,m->mn", _GAUSS[1], flux, half)
    return integrals if axis == 0 else integrals.T


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
