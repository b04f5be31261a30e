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


def _weights(axis: RealArray, x: float) -> Array | None:
    """Weight of each node (n,) for a value at x; None where x is more than the largest step outside."""
    nodes = np.asarray(axis, dtype=np.float64)
    step = float(np.diff(nodes).max()) if len(nodes) > 1 else np.inf
    held = float(np.clip(x, nodes[0], nodes[-1]))
    if abs(x - held) > step:
        return None
    return np.array([np.interp(held, nodes, row) for row in np.eye(len(nodes))])
