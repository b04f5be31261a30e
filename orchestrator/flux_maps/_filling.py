"""Smooth continuation of a table into its holes, by least curvature."""

from __future__ import annotations

from typing import Any

import numpy as np

from orchestrator.numerics.types import Array
from protocols import InputError


def fill_smoothly(x: Array, y: Array, table: Array, where: str = "flux map") -> Array:
    """The table with its NaN nodes continued by least curvature.

    Minimises the sum of the squared second differences z_xx^2 + 2 z_xy^2 + z_yy^2 (a thin plate through the known
    nodes), so that a plane is continued exactly: a flux with constant inductances stays one.

    Parameters
    ----------
    x, y : array, shapes (n,), (m,)
        Increasing axes, same unit.
    table : array, shape (n, m)
        Known nodes are returned unchanged.
    where : str
        Name for the error.

    Raises
    ------
    InputError
        Where fewer than three nodes are known, or all of them lie on one line.
    """
    known = np.isfinite(table)
    if known.all():
        return table
    from scipy.sparse.linalg import spsolve

    rows, columns = np.nonzero(known)
    places = np.column_stack((np.ones(len(rows)), x[rows], y[columns]))
    if len(rows) < 3 or np.linalg.matrix_rank(places) < 3:
        raise InputError(where, "", f"{len(rows)} known points do not span an area")
    curvature = _curvature(x, y)
    inside = known.ravel()
    unknown, given = curvature[:, ~inside], curvature[:, inside]
    right = -(unknown.T @ (given @ table[known]))
    filled = table.copy()
    filled[~known] = spsolve((unknown.T @ unknown).tocsc(), right)
    return filled


def _curvature(x: Array, y: Array) -> Any:
    """Second differences over the whole table, as a sparse matrix on its raveled nodes."""
    from scipy.sparse import eye_array, kron, vstack

    scale = 0.5 * (float(np.diff(x).mean()) + float(np.diff(y).mean()))
    u, v = x / scale, y / scale
    return vstack(
        [
            kron(_second(u), eye_array(len(v))),
            kron(eye_array(len(u)), _second(v)),
            np.sqrt(2.0) * kron(_first(u), _first(v)),
        ]
    ).tocsc()


def _first(u: Array) -> Any:
    from scipy.sparse import diags_array

    h = np.diff(u)
    return diags_array([-1.0 / h, 1.0 / h], offsets=[0, 1], shape=(len(h), len(u)))


def _second(u: Array) -> Any:
    from scipy.sparse import diags_array

    left, right = np.diff(u)[:-1], np.diff(u)[1:]
    bands = [2.0 / (left * (left + right)), -2.0 / (left * right), 2.0 / (right * (left + right))]
    return diags_array(bands, offsets=[0, 1, 2], shape=(len(left), len(u)))
