"""Consistency of a flux map with physics, with itself and with another map, without a reference map.

Percentages refer to |psi(rated i_q) - psi(0, 0)|, or to the flux at the edge of a map that does not reach the rated
current; a quantity outside the map's range is None.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from orchestrator.numerics.types import Array
from protocols import AxisPercent, FluxMap, MapChecks, Motor


def rated_flux_wb(flux_map: FluxMap, rated_current_a: float | None) -> float | None:
    """|psi(0, rated i_q) - psi(0, 0)| of a map [Wb]; None where the map does not reach that far."""
    if rated_current_a is None:
        return None
    psi = flux_at(flux_map)(np.array([[0.0, rated_current_a], [0.0, -rated_current_a], [0.0, 0.0]]))
    sides = np.linalg.norm(psi[:2] - psi[2], axis=1)
    return float(np.nanmean(sides)) if np.isfinite(sides).any() else None


def edge_flux_wb(flux_map: FluxMap) -> float | None:
    """Largest |psi(i) - psi(0, 0)| at i_d = 0, or in the whole map where that has no such line [Wb].

    None where a map lacks zero current, or has only that.
    """
    zero = flux_at(flux_map)(np.zeros((1, 2)))[0]
    away = np.hypot(flux_map.psi_d - zero[0], flux_map.psi_q - zero[1])
    line = away[int(np.argmin(np.abs(flux_map.i_d)))]
    for known in (line[np.isfinite(line)], away[np.isfinite(away)]):
        if known.max(initial=0.0) > 0.0:
            return float(known.max())
    return None


def reference_flux_wb(flux_map: FluxMap, motor: Motor) -> float | None:
    """Reference flux for a map's errors in percent [Wb].

    The flux of the rated current where the map contains it; else that at the map's edge, or finally the magnet's.
    """
    return rated_flux_wb(flux_map, motor.rated_current_a) or edge_flux_wb(flux_map) or motor.pm_flux_wb


def band_percent(flux_map: FluxMap, reference_wb: float | None) -> float | None:
    """Half width of the 95 % band of one axis' flux, rms over the map; None where it is not known."""
    variance = flux_map.psi_d_std**2 + flux_map.psi_q_std**2
    if not reference_wb or not np.isfinite(variance).any():
        return None
    return 100.0 * 1.96 * math.sqrt(0.5 * float(np.nanmean(variance))) / reference_wb


def flux_at(flux_map: FluxMap) -> Callable[[Array], Array]:
    """Function from currents, shape (n, 2), to fluxes, shape (n, 2): bilinear, NaN outside the map."""
    return values_at(flux_map, "psi_d", "psi_q")


def values_at(flux_map: FluxMap, *names: str) -> Callable[[Array], Array]:
    """Function from currents, shape (n, 2), to a map's tables of these names, shape (n, k), as of `flux_at`."""
    from scipy.interpolate import RegularGridInterpolator

    table = np.stack([getattr(flux_map, name) for name in names], axis=-1)
    lookup = RegularGridInterpolator((flux_map.i_d, flux_map.i_q), table, bounds_error=False, fill_value=np.nan)
    return lambda i_dq: np.asarray(lookup(i_dq), dtype=np.float64)


def check_map(flux_map: FluxMap, rated_wb: float | None, misfit: Array | None) -> MapChecks:
    """Crossings, parity and reciprocity of a map.

    Parameters
    ----------
    flux_map : FluxMap
    rated_wb : float or None
        From `reference_flux_wb`.
    misfit : array, shape (c, 2), or None
        Flux differences where current paths cross [Wb].
    """
    crossings = parity = None
    if rated_wb:
        if misfit is not None and len(misfit):
            worst = 100.0 / rated_wb * np.abs(misfit).max(axis=0)
            crossings = AxisPercent(d_percent=float(worst[0]), q_percent=float(worst[1]))
        parity = _parity(flux_map, rated_wb)
    return MapChecks(crossings=crossings, parity=parity, reciprocity_percent=_reciprocity_percent(flux_map))


def _parity(flux_map: FluxMap, rated_wb: float) -> AxisPercent | None:
    """Largest odd part of psi_d and even part of psi_q in i_q."""
    q = flux_map.i_q
    mirror = np.argmin(np.abs(q[:, None] + q[None, :]), axis=1)
    pairs = np.abs(q + q[mirror]) < 1e-6 * np.ptp(q)
    odd_d = 0.5 * (flux_map.psi_d - flux_map.psi_d[:, mirror])[:, pairs & (q > 0)]
    even_q = 0.5 * (flux_map.psi_q + flux_map.psi_q[:, mirror])[:, pairs & (q > 0)]
    if not np.isfinite(odd_d).any():
        return None
    d, q_percent = (100.0 / rated_wb * float(np.nanmax(np.abs(x))) for x in (odd_d, even_q))
    return AxisPercent(d_percent=d, q_percent=q_percent)


def _reciprocity_percent(flux_map: FluxMap) -> float | None:
    if min(len(flux_map.i_d), len(flux_map.i_q)) < 3:
        return None
    d_by_q = np.gradient(flux_map.psi_d, flux_map.i_q, axis=1)
    q_by_d = np.gradient(flux_map.psi_q, flux_map.i_d, axis=0)
    curl = (d_by_q - q_by_d)[1:-1, 1:-1]
    inductance = 0.5 * (flux_map.l_dd + flux_map.l_qq)
    if not np.isfinite(curl).any() or not np.isfinite(inductance).any():
        return None
    return float(100.0 * np.sqrt(np.nanmean(curl**2)) / np.nanmean(inductance))


def difference_percent(one: FluxMap, other: FluxMap, rated_wb: float | None) -> float | None:
    """rms over `one`'s grid of |psi_one - psi_other|, each less its own psi(0, 0)."""
    if not rated_wb:
        return None
    a, b = _flux_of_both(one, other)
    squares = ((a - b) ** 2).sum(axis=1)
    if not np.isfinite(squares).any():
        return None
    return float(100.0 / rated_wb * np.sqrt(np.nanmean(squares)))


def flux_ratio(one: FluxMap, other: FluxMap) -> tuple[float, float] | None:
    """Ratio of `one`'s flux to `other`'s, each less its own psi(0, 0), and the ratio's standard deviation.

    The errors of a map count as fully correlated over it. None where the maps do not overlap.
    """
    a, b = _flux_of_both(one, other)
    valid = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    size = float((b[valid] ** 2).sum())
    if size == 0.0:
        return None
    spread = [float(np.nanmean(m.psi_d_std**2 + m.psi_q_std**2)) for m in (one, other)]
    return float((a[valid] * b[valid]).sum()) / size, float(np.sqrt(sum(spread) * valid.sum() / size))


def _flux_of_both(one: FluxMap, other: FluxMap) -> tuple[Array, Array]:
    """Fluxes of both maps at the currents of `one`'s grid, each less its own psi(0, 0), shape (n, 2) each."""
    axes = (one.i_d.astype(np.float64), one.i_q.astype(np.float64))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    zero = np.zeros((1, 2))
    return flux_at(one)(grid) - flux_at(one)(zero), flux_at(other)(grid) - flux_at(other)(zero)
