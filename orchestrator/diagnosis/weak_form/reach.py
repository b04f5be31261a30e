"""Whether currents lie among others: beyond them a map is what its smoothness says, and nothing judges a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.numerics.types import Array

HULL_TOLERANCE = 0.1
"""Of the largest current, by which a current may be beyond the others; and the part of them that may be further."""


def lies_among(current: Array, others: Sequence[Array]) -> bool:
    """Whether nearly all currents (n, 2) are within the convex hull of others; on a line, between its ends.

    False where there are no others.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not others:
        return False
    around = np.concatenate(others)
    slack = HULL_TOLERANCE * float(np.abs(around).max(initial=0.0))
    try:
        sides = ConvexHull(around).equations
        beyond = (current @ sides[:, :2].T + sides[:, 2]).max(axis=1)
    except QhullError:
        low, high = around.min(axis=0), around.max(axis=0)
        beyond = np.maximum(low - current, current - high).max(axis=1)
    return bool((beyond > slack).mean() <= HULL_TOLERANCE)
