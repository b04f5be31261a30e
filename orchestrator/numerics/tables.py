"""Values of a table between its nodes; fits nothing."""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.types import Array
from protocols import RealArray


def value_at(axes: tuple[RealArray, RealArray], table: RealArray, x: float, y: float) -> float | None:
    """A table's value at (x, y), linear between the nodes around it.

    Parameters
    ----------
    axes : pair of array, shapes (m,), (n,)
        Increasing.
    table : array, shape (m, n)
        NaN where nothing is known: such nodes leave their weight to the other ones of the cell.

    Returns
    -------
    float or None
        At the nearest edge where the point is up to a step outside; None farther out, and where no node is known.
    """
    of_rows, of_columns = _weights(axes[0], x), _weights(axes[1], y)
    if of_rows is None or of_columns is None:
        return None
    weights = np.outer(of_rows, of_columns)
    used = (weights > 0.0) & np.isfinite(table)
    if not used.any():
        return None
    return float(np.sum(weights[used] * np.asarray(table)[used]) / weights[used].sum())


def cubic_value_at(axes: tuple[RealArray, RealArray], table: RealArray, x: float, y: float) -> float | None:
    """A table's value at (x, y), by the cubics through the four nodes nearest on either axis.

    Parameters and return value as of `value_at`, which answers where one of these sixteen nodes is not known.
    """
    of_rows, of_columns = _four_nodes(axes[0], x), _four_nodes(axes[1], y)
    if of_rows is None or of_columns is None:
        return value_at(axes, table, x, y)
    (first, row_weights), (left, column_weights) = of_rows, of_columns
    block = np.asarray(table)[first : first + 4, left : left + 4]
    return float(row_weights @ block @ column_weights) if np.isfinite(block).all() else value_at(axes, table, x, y)


def _four_nodes(axis: RealArray, x: float) -> tuple[int, Array] | None:
    """Index of the first of four nodes about x, and Lagrange's weights of the four; None where x lies outside."""
    nodes = np.asarray(axis, dtype=np.float64)
    if len(nodes) < 4 or not nodes[0] <= x <= nodes[-1]:
        return None
    first = int(np.clip(np.searchsorted(nodes, x) - 2, 0, len(nodes) - 4))
    four = nodes[first : first + 4]
    others = [np.delete(four, k) for k in range(4)]
    return first, np.array([np.prod((x - rest) / (own - rest)) for own, rest in zip(four, others, strict=True)])


def _weights(axis: RealArray, x: float) -> Array | None:
    """Weight of each node (n,) for a value at x; None where x is more than the largest step outside."""
    nodes = np.asarray(axis, dtype=np.float64)
    step = float(np.diff(nodes).max()) if len(nodes) > 1 else np.inf
    held = float(np.clip(x, nodes[0], nodes[-1]))
    if abs(x - held) > step:
        return None
    return np.array([np.interp(held, nodes, row) for row in np.eye(len(nodes))])
