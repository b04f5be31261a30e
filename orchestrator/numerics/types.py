"""Array types of the numerics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers; shapes and units are documented at each use."""
Indices = NDArray[np.intp]
"""Indices of an array."""
Mask = NDArray[np.bool_]
"""A selection of an array's elements."""
