"""Arrays held against each other by the size of what they hold: no unit, and no machine's rounding, decides."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def assert_close(found: ArrayLike, expected: ArrayLike, relative: float, *, of: ArrayLike | None = None) -> None:
    """Assert that no element differs by more than `relative` times the largest one expected, or the largest `of`.

    Where that is zero, nothing may differ at all.
    """
    size = float(np.nanmax(np.abs(np.asarray(expected if of is None else of))))
    np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=0.0, atol=relative * size)
