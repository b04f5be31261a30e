"""Points of a flux map that lie on no rectangular grid, interpolated onto one; judges no flux.

A cubic radial basis function passes through every point (Wendland, Scattered Data Approximation, 2005). Nodes are the
set-points that the currents scatter about, or evenly spaced ones inside the convex hull of the points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array, Mask
from protocols import InputError, Remark

Index = NDArray[np.intp]

_MIN_POINTS = 9
"""A quadratic in two variables has six coefficients; fewer points than this do not check it."""
_MIN_NODES_PER_AXIS, _MAX_NODES_PER_AXIS = 5, 60
"""Limits of the grid's nodes on each axis."""
_MAX_REPEAT_SHARE = 0.01
"""Share of the flux' swing by which readings of one current may differ and still be averaged."""
_MIN_SINGULAR_VALUE_RATIO = 0.02
"""Ratio to the largest, in a quadratic over the points: below it they lie on one conic without cross-saturation."""
_MAX_GAP_SPACINGS = 3.0
"""Distance of a node from every point, in spacings of points, beyond which it is not measured."""
_MIN_COVERED_SHARE = 0.9
"""Share of the nodes between the points that have to be measured."""
_MAX_CLUSTER_WIDTH = 0.25
"""Share of the least distance between set-points over which the currents about one of them may scatter."""
_MAX_DENSE_POINTS = 1500
"""Points up to which one system of equations has them all; beyond, each node uses its nearest ones."""
_NEIGHBOURS = 80
"""Nearest points of each node."""


def distinct_values(values: Array) -> tuple[Array, Index]:
    """Distinct values within a millionth of their span, increasing, and the index of each value among them."""
    order = np.argsort(values, kind="stable")
    return _split(values, order, np.diff(values[order]) > 1e-6 * np.ptp(values))


def on_rectangular_grid(where: str, points: Mapping[str, Array]) -> tuple[dict[str, Array], Remark]:
    """The points interpolated at the nodes of a rectangular grid, and a remark on the interpolation.

    Parameters
    ----------
    where : str
        Name for errors.
    points : mapping
        Arrays of shape (n,): `i_d`, `i_q` [A], `psi_d`, `psi_q` [Wb], and any further quantity of the currents.

    Returns
    -------
    columns : dict
        The same quantities at the nodes that the points surround.
    remark : Remark
        With the cross-validation error.

    Raises
    ------
    InputError
        Where readings of one current contradict each other, or the points do not cover an area.
    """
    known = np.isfinite(points["psi_d"]) & np.isfinite(points["psi_q"])
    finite = {name: values[known] for name, values in points.items() if np.isfinite(values[known]).all()}
    if np.count_nonzero(known) < _MIN_POINTS:
        problem = f"{np.count_nonzero(known)} points that do not lie on a rectangular grid: too few to interpolate"
        raise InputError(where, "i_d, i_q", problem)
    swing_wb = 0.5 * max(float(np.ptp(finite["psi_d"])), float(np.ptp(finite["psi_q"])))
    places = [distinct_values(finite[axis]) for axis in ("i_d", "i_q")]
    merged = _average(where, finite, places[0][1], places[1][1], _MAX_REPEAT_SHARE * swing_wb)
    _require_area(where, merged["i_d"], merged["i_q"])
    setpoints = _setpoints(merged)
    if setpoints is None:
        nodes = _between_points(where, merged["i_d"], merged["i_q"])
        how = f"{len(merged['i_d'])} points, not on a rectangular grid, are interpolated at {len(nodes)} nodes"
    else:
        merged, nodes = setpoints
        how = f"currents scatter about {len(nodes)} set-points, and fluxes are interpolated there"
    names = [name for name in merged if name not in ("i_d", "i_q")]
    surface = _Surface(merged, names)
    columns = {"i_d": nodes[:, 0], "i_q": nodes[:, 1]} | dict(zip(names, surface.at(nodes).T, strict=True))
    return columns, Remark.of(
        "regridded",
        "{how}; cross-validation error {error_percent:.2g} % of the swing, rms",
        how=how,
        points=len(merged["i_d"]),
        nodes=len(nodes),
        error_percent=100.0 * surface.cross_validation_wb() / swing_wb if swing_wb > 0 else 0.0,
    )


@dataclass(frozen=True)
class _Surface:
    """Quantities over points, as one smooth function of the current."""

    points: Mapping[str, Array]
    names: list[str]

    def at(self, nodes: Array, of: Mask | None = None) -> Array:
        """Quantities at currents, shape (n, names); from all points, or those of a mask."""
        from scipy.interpolate import RBFInterpolator

        currents = np.column_stack((self.points["i_d"], self.points["i_q"]))
        spans = np.ptp(currents, axis=0)
        values = np.column_stack([self.points[name] for name in self.names])
        if of is not None:
            currents, values = currents[of], values[of]
        # Scaled to similar size, because one system is solved for all of them.
        sizes = np.maximum(np.abs(values).max(axis=0), np.finfo(float).tiny)
        neighbours = None if len(currents) <= _MAX_DENSE_POINTS else _NEIGHBOURS
        surface: Any = RBFInterpolator(currents / spans, values / sizes, neighbors=neighbours, kernel="cubic")
        found: Array = surface(nodes / spans) * sizes
        return found

    def cross_validation_wb(self) -> float:
        """rms error of the flux at every fifth point, predicted by the others [Wb]."""
        out = np.arange(len(self.points["i_d"])) % 5 == 2
        currents = np.column_stack((self.points["i_d"], self.points["i_q"]))[out]
        predicted = self.at(currents, of=~out)
        errors = [predicted[:, self.names.index(name)] - self.points[name][out] for name in ("psi_d", "psi_q")]
        return float(np.sqrt(np.mean(np.square(errors))))


def _average(
    where: str, points: Mapping[str, Array], rows: Index, places: Index, largest_wb: float
) -> dict[str, Array]:
    """One point for each pair of indices; `largest_wb` is the largest difference of their fluxes."""
    _, first, index = np.unique(rows * (int(places.max()) + 1) + places, return_index=True, return_inverse=True)
    count = np.bincount(index)
    means = {name: np.bincount(index, weights=values) / count for name, values in points.items()}
    for name in ("psi_d", "psi_q"):
        distance = np.abs(points[name] - means[name][index])
        worst = int(np.argmax(distance))
        if distance[worst] > largest_wb:
            at = first[index[worst]]
            current = f"({points['i_d'][at]:g}, {points['i_q'][at]:g}) A"
            problem = f"the current {current} occurs more than once, with fluxes {2e3 * distance[worst]:.3g} mWb apart"
            raise InputError(where, "i_d, i_q", problem)
    return means


def _require_area(where: str, i_d: Array, i_q: Array) -> None:
    """Raise `InputError` where the points lie on a line, a cross or another conic."""
    if min(np.ptp(i_d), np.ptp(i_q)) > 0.0 and i_d.size >= _MIN_POINTS:
        x, y = (2.0 * (axis - axis.min()) / np.ptp(axis) - 1.0 for axis in (i_d, i_q))
        sizes = np.linalg.svd(np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y)), compute_uv=False)
        if sizes[-1] > _MIN_SINGULAR_VALUE_RATIO * sizes[0]:
            return
    problem = (
        f"{i_d.size} points that do not lie on a rectangular grid, nor cover an area (a line, a cross or a curve?)"
    )
    raise InputError(where, "i_d, i_q", problem)


def _setpoints(points: Mapping[str, Array]) -> tuple[dict[str, Array], Array] | None:
    """One point for each set-point, and the set-points as nodes, shape (n, 2); None where currents do not gather."""
    clusters = [_clusters(points[axis]) for axis in ("i_d", "i_q")]
    if clusters[0] is None or clusters[1] is None:
        return None
    (i_d, rows), (i_q, places) = clusters[0], clusters[1]
    if i_d.size * i_q.size > 4 * rows.size:
        return None
    one = _average("", points, rows, places, np.inf)
    pairs = np.unique(np.column_stack((rows, places)), axis=0)
    return one, np.column_stack((i_d[pairs[:, 0]], i_q[pairs[:, 1]]))


def _clusters(values: Array) -> tuple[Array, Index] | None:
    """Cluster means of values, and the index of each value's cluster; None where there are no clusters."""
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order])
    sizes = np.sort(gaps)[::-1]
    # Among the larger gaps only: clusters of one value each are none.
    count = max(1, values.size // 2)
    split = int(np.argmax(sizes[:count] / np.maximum(sizes[1 : count + 1], 1e-9 * np.ptp(values))))
    means, index = _split(values, order, gaps >= sizes[split])
    means = np.bincount(index, weights=values) / np.bincount(index)
    widths = np.zeros(means.size)
    np.maximum.at(widths, index, np.abs(values - means[index]))
    if means.size < 2 or 2.0 * widths.max() > _MAX_CLUSTER_WIDTH * np.diff(means).min():
        return None
    return means, index


def _split(values: Array, order: Index, new: Mask) -> tuple[Array, Index]:
    """The first value of each group, and each value's group; `new` marks the first of a group in the given order."""
    index = np.empty(len(values), dtype=np.intp)
    index[order] = np.concatenate(([0], np.cumsum(new)))
    return values[order][np.concatenate(([True], new))], index


def _between_points(where: str, i_d: Array, i_q: Array) -> Array:
    """Nodes of an even grid that lie between the points, shape (n, 2) [A]."""
    from scipy.spatial import Delaunay, cKDTree

    spans = np.array([np.ptp(i_d), np.ptp(i_q)])
    scaled = np.column_stack((i_d, i_q)) / spans
    hull = Delaunay(scaled)
    corners = scaled[hull.simplices]
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * float(np.abs(np.linalg.det(sides)).sum())
    count = int(np.clip(round(np.sqrt(i_d.size / area)), _MIN_NODES_PER_AXIS, _MAX_NODES_PER_AXIS))
    axes = [_even(float(axis.min()), float(axis.max()), count) for axis in (i_d, i_q)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = nodes[hull.find_simplex(nodes / spans, tol=1e-6) >= 0]
    tree: Any = cKDTree(scaled)
    spacing = float(np.median(tree.query(scaled, k=2)[0][:, 1]))
    near = tree.query(inside / spans)[0] <= _MAX_GAP_SPACINGS * spacing
    covered = np.count_nonzero(near) / max(near.size, 1)
    if covered < _MIN_COVERED_SHARE:
        problem = f"{i_d.size} points that leave {100.0 * (1.0 - covered):.0f} % of the area between them unmeasured"
        raise InputError(where, "i_d, i_q", problem)
    found: Array = inside[near]
    return found


def _even(low: float, high: float, count: int) -> Array:
    """Some `count` evenly spaced values with zero among them where it lies between, and mirrored where the ends are."""
    if low < 0.0 < high:
        step = max(-low, high) / max(1, round(max(-low, high) / (high - low) * (count - 1)))
        below, above = np.floor(-low / step + 1e-3), np.floor(high / step + 1e-3)
        return step * np.arange(-below, above + 1.0)
    return np.linspace(low, high, count)
