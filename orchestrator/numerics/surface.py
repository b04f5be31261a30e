"""Surfaces over the current plane from scattered points, inside their hull only.

`TaylorSurface` is for values with measured derivatives, `SmoothSurface` for values alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from protocols import NotMeasuredError

if TYPE_CHECKING:
    from scipy.spatial import Delaunay


def triangulate(points: Array, where: str) -> Delaunay:
    """Delaunay triangulation of scattered points, shape (n, 2).

    Raises
    ------
    NotMeasuredError
        If they do not span an area.
    """
    from scipy.spatial import Delaunay, QhullError

    try:
        return Delaunay(points)
    except (QhullError, ValueError) as error:
        raise NotMeasuredError(where, "points", f"{len(points)} points do not span an area of currents") from error


def require_area(points: Array, where: str) -> None:
    """Raise `NotMeasuredError` where scattered currents do not spread in two directions."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 2 else np.zeros(2)
    if spread[1] <= 0.05 * spread[0]:
        raise NotMeasuredError(where, "points", f"{len(points)} points do not span an area of currents")


class TaylorSurface:
    """Blend of Taylor polynomials of the three corners of each triangle.

    The m-th of r derivatives is weighted by (r + 1 - m) / (r + 1), which reproduces polynomials one
    degree higher than the corners' own (A. Guessab, O. Nouisser, G. Schmeisser, "Multivariate approximation
    by a combination of modified Taylor polynomials", J. Comput. Appl. Math. 196 (2006) 162-179,
    doi:10.1016/j.cam.2005.08.015). Continuous across edges, linear in the data.

    Parameters
    ----------
    points : array, shape (n, 2)
    at : array, shape (m, 2)
        Points of evaluation.

    Attributes
    ----------
    inside : array of bool, shape (m,)
    corners, weights : array, shape (m, 3)
        Triangle and barycentric coordinates of each point; in a sliver, of the nearest point on its shorter sides.
    is_sliver : array of bool, shape (m,)
        Whether that triangle is a sliver at the hull, between nearly collinear points. The far end of its longest side
        has no information on values between the other two, and gradients do not hold across it.
    """

    def __init__(self, points: Array, at: Array, where: str) -> None:
        mesh = triangulate(points, where)
        # A point on the hull is inside it; rounding must not decide.
        simplex = mesh.find_simplex(at, tol=1e-9)
        self.inside: NDArray[np.bool_] = simplex >= 0
        transform = mesh.transform[simplex]
        first = np.einsum("mij,mj->mi", transform[:, :2], at - transform[:, 2])
        self.weights = np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)
        self.corners = mesh.simplices[simplex]
        self.weights[~self.inside] = np.nan
        triangles = points[self.corners]
        self.is_sliver = self.inside & _are_slivers(triangles)
        self.weights[self.is_sliver] = _along_short_sides(triangles[self.is_sliver], at[self.is_sliver])
        on_mesh = np.einsum("mc,mci->mi", self.weights, triangles)
        self._steps = on_mesh[:, None, :] - triangles
        self._beside = at - on_mesh  # zero except in a sliver

    def __call__(self, value: Array, gradient: Array | None = None, second: Array | None = None) -> Array:
        """Values at the points of evaluation, shape (m,); NaN outside the hull.

        Parameters
        ----------
        value, gradient, second : array, shapes (n,), (n, 2), (n, 2, 2)
        """
        order = 0 if gradient is None else (1 if second is None else 2)
        terms = value[self.corners]
        if gradient is not None:
            steps = order / (order + 1) * self._steps + self._beside[:, None, :]
            terms = terms + np.einsum("mci,mci->mc", gradient[self.corners], steps)
        if second is not None:
            curved = np.einsum("mcij,mci,mcj->mc", second[self.corners], self._steps, self._steps)
            terms = terms + 0.5 / 3.0 * curved
        out: Array = np.einsum("mc,mc->m", self.weights, terms)
        return out


def _are_slivers(triangles: Array, max_ratio: float = 0.05) -> NDArray[np.bool_]:
    """Whether a triangle's area is less than this part of its longest side's square; shapes (m, 3, 2) -> (m,)."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    area = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    out: NDArray[np.bool_] = area < max_ratio * (sides**2).sum(axis=-1).max(axis=-1)
    return out


def _along_short_sides(triangles: Array, at: Array) -> Array:
    """Barycentric coordinates of the nearest point on the two shorter sides; shapes (m, 3, 2), (m, 2) -> (m, 3)."""
    rows = np.arange(len(at))
    opposite = np.linalg.norm(np.roll(triangles, -2, axis=1) - np.roll(triangles, -1, axis=1), axis=2)
    middle = opposite.argmax(axis=1)
    best, nearest = np.full(len(at), np.inf), np.zeros((len(at), 3))
    for turn in (1, 2):
        end = (middle + turn) % 3
        side = triangles[rows, end] - triangles[rows, middle]
        from_middle = at - triangles[rows, middle]
        part = np.clip((from_middle * side).sum(axis=1) / (side**2).sum(axis=1), 0.0, 1.0)
        away = np.linalg.norm(from_middle - part[:, None] * side, axis=1)
        weights = np.zeros((len(at), 3))
        weights[rows, middle], weights[rows, end] = 1.0 - part, part
        nearest = np.where((away < best)[:, None], weights, nearest)
        best = np.minimum(away, best)
    return nearest


class SmoothSurface:
    """Cubic radial basis functions through scattered vectors, with their derivatives by differences.

    Parameters
    ----------
    points : array, shape (n, 2)
    values : array, shape (n, k)
    smoothing : float
        Smoothing of scipy's `RBFInterpolator`.
    """

    def __init__(self, points: Array, values: Array, smoothing: float = 0.0) -> None:
        from scipy.interpolate import RBFInterpolator

        self._scale = float(np.ptp(points, axis=0).max())
        self._surface: Any = RBFInterpolator(points / self._scale, values, kernel="cubic", smoothing=smoothing)

    def __call__(self, at: Array) -> Array:
        """Values, shape (m, k), valid inside the hull."""
        out: Array = self._surface(at / self._scale)
        return out

    def gradient(self, at: Array) -> Array:
        """Derivatives by central differences, shape (m, k, 2)."""
        step = 1e-3 * self._scale
        sides = [(self(at + e) - self(at - e)) / (2.0 * step) for e in step * np.eye(2)]
        return np.stack(sides, axis=-1)


def inside_hull(points: Array, at: Array, where: str) -> NDArray[np.bool_]:
    """Whether points of evaluation lie in the convex hull of the points."""
    inside: NDArray[np.bool_] = triangulate(points, where).find_simplex(at, tol=1e-9) >= 0
    return inside


def current_axes(points: Array) -> tuple[Array, Array]:
    """Round-numbered axes that cover scattered currents in about sixty steps, with zero on each if it is in range."""
    return _round_axis(points[:, 0]), _round_axis(points[:, 1])


def _round_axis(values: Array) -> Array:
    span = float(np.ptp(values))
    decade = 10.0 ** np.floor(np.log10(span / 64.0))
    step = next(f * decade for f in (1.0, 2.0, 5.0, 10.0) if f * decade * 64.0 >= span)
    low, high = np.ceil(values.min() / step - 1e-9), np.floor(values.max() / step + 1e-9)
    axis: Array = np.arange(low, high + 1) * step
    return axis
