"""A smooth psi(i) through a flux map's points, and the region that was measured; fits nothing, averages nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.flux_maps._filling import fill_smoothly
from orchestrator.numerics.types import Array, Mask
from protocols import FluxMap, InputError

WHERE = "flux map"


def require_usable(flux_map: FluxMap, where: str = WHERE) -> None:
    """Raise `InputError` unless the axes increase, hold two points or more, and three fluxes are known."""
    for name in ("i_d", "i_q"):
        axis = getattr(flux_map, name)
        if len(axis) < 2 or not (np.isfinite(axis).all() and (np.diff(axis) > 0).all()):
            raise InputError(where, name, "expected two or more finite, increasing currents")
    if np.isfinite(flux_map.psi_d + flux_map.psi_q).sum() < 3:
        raise InputError(where, "psi_d", "fewer than three points with a flux linkage")


class MapSurface:
    """Cubic splines through the measured points, with holes continued by least curvature.

    Passes through every measured point. Beyond the grid it goes on along its tangent, so that a search may step
    outside and come back; `inside` tells what is measured.

    Parameters
    ----------
    flux_map : FluxMap

    Attributes
    ----------
    i_d, i_q : array, shapes (d,), (q,)
    known : array of bool, shape (d, q)
        Grid points with a measured flux.

    Raises
    ------
    InputError
        Where the axes do not increase or the known points do not span an area.
    """

    def __init__(self, flux_map: FluxMap) -> None:
        require_usable(flux_map)
        self.i_d, self.i_q = (np.asarray(axis, dtype=np.float64) for axis in (flux_map.i_d, flux_map.i_q))
        tables = [np.asarray(table, dtype=np.float64) for table in (flux_map.psi_d, flux_map.psi_q)]
        self.known: Mask = np.isfinite(tables[0]) & np.isfinite(tables[1])
        self.filled = [fill_smoothly(self.i_d, self.i_q, np.where(self.known, t, np.nan), WHERE) for t in tables]
        self._splines = [_spline(self.i_d, self.i_q, table) for table in self.filled]

    @property
    def currents(self) -> Array:
        """Currents of the measured points, shape (k, 2) [A]."""
        rows, columns = np.nonzero(self.known)
        return np.column_stack((self.i_d[rows], self.i_q[columns]))

    @property
    def fluxes(self) -> Array:
        """Fluxes of the measured points, shape (k, 2) [Wb]."""
        return np.column_stack([table[self.known] for table in self.filled])

    def psi(self, i_dq: Array) -> Array:
        """Flux linkages [Wb], shape (n, 2), at currents of shape (n, 2) [A]."""
        held = self._held(i_dq)
        out = np.column_stack([spline.ev(held[:, 0], held[:, 1]) for spline in self._splines])
        beyond = i_dq - held
        if beyond.any():
            out += np.einsum("nij,nj->ni", self._slopes(held), beyond)
        return out

    def jacobian(self, i_dq: Array) -> Array:
        """dpsi_i/di_j [H], shape (n, 2, 2); constant beyond the grid."""
        return self._slopes(self._held(i_dq))

    def inside(self, i_dq: Array) -> Mask:
        """Whether currents lie in the measured region: in a grid triangle whose corners are all measured."""
        (k, u), (m, v) = _cell(self.i_d, i_dq[:, 0]), _cell(self.i_q, i_dq[:, 1])
        within = (np.abs(u - 0.5) <= 0.5 + 1e-6) & (np.abs(v - 0.5) <= 0.5 + 1e-6)
        # A corner of zero weight need not be measured: nodes and edges count as measured.
        missing = {(a, b): ~self.known[k + a, m + b] for a in (0, 1) for b in (0, 1)}

        def whole(*corners: tuple[tuple[int, int], Array]) -> Mask:
            lacking = [missing[corner] & (weight > 1e-6) for corner, weight in corners]
            complete: Mask = ~np.any(lacking, axis=0)
            return complete

        lower = whole(((0, 0), 1 - u), ((1, 0), u - v), ((1, 1), v))
        upper = whole(((0, 0), 1 - v), ((0, 1), v - u), ((1, 1), u))
        left = whole(((0, 0), 1 - u - v), ((1, 0), u), ((0, 1), v))
        right = whole(((1, 1), u + v - 1), ((1, 0), 1 - v), ((0, 1), 1 - u))
        inside: Mask = within & (np.where(u >= v, lower, upper) | np.where(u + v <= 1, left, right))
        return inside

    def _held(self, i_dq: Array) -> Array:
        low, high = (self.i_d[0], self.i_q[0]), (self.i_d[-1], self.i_q[-1])
        held: Array = np.clip(i_dq, low, high)
        return held

    def _slopes(self, held: Array) -> Array:
        d, q = held[:, 0], held[:, 1]
        rows = [np.stack((s.ev(d, q, dx=1), s.ev(d, q, dy=1)), axis=-1) for s in self._splines]
        return np.stack(rows, axis=1)


def _spline(x: Array, y: Array, table: Array) -> Any:
    """Interpolating spline, cubic where there are enough nodes."""
    from scipy.interpolate import RectBivariateSpline

    if len(x) == 2:  # a straight line is given a middle, because FITPACK has no slope of a spline of first degree
        x, table = np.linspace(x[0], x[1], 3), np.stack((table[0], table.mean(axis=0), table[1]))
    if len(y) == 2:
        y, table = np.linspace(y[0], y[1], 3), np.stack((table[:, 0], table.mean(axis=1), table[:, 1]), axis=1)
    return RectBivariateSpline(x, y, table, kx=min(3, len(x) - 1), ky=min(3, len(y) - 1), s=0.0)


def _cell(axis: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Index of the cell, and the place in it from 0 to 1."""
    k = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, len(axis) - 2)
    return k, (at - axis[k]) / (axis[k + 1] - axis[k])
