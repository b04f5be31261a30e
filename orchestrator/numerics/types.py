"""The arrays of the numerics: one name each, for everything that computes with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers; shapes and units stand where one is used."""
Indices = NDArray[np.intp]
"""Places in an array."""
Mask = NDArray[np.bool_]
"""Which of an array's elements are meant."""
