"""The error of a linear lookup in an exported table."""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.types import Array


def lookup_error(
    rows: Array, columns: Array, tables: tuple[Array, Array], at: Array, truth: Array
) -> tuple[float, float]:
    """rms and largest length of the difference between bilinear lookups and the truth.

    Parameters
    ----------
    rows, columns : array, shapes (n,), (m,)
        Axes of the two tables, which have shape (n, m).
    at, truth : array, shape (k, 2)
        Points on the axes, and their true values.
    """
    from scipy.interpolate import RegularGridInterpolator

    lookup = RegularGridInterpolator((rows, columns), np.stack(tables, axis=-1), bounds_error=False, fill_value=None)
    apart = np.linalg.norm(np.asarray(lookup(at)) - truth, axis=1)
    return float(np.sqrt((apart**2).mean())), float(apart.max())
