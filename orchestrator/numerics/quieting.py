"""Removal of white noise from a record by thresholding its cosine spectrum.

Hard thresholding after D. L. Donoho and I. M. Johnstone, Biometrika 81 (1994), doi:10.1093/biomet/81.3.425. Their
threshold sqrt(2 ln n) removes all noise; three standard deviations keep a little of it, and more of a curvature.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct, idct

from orchestrator.numerics.types import Array

KEEP_SIGMAS = 3.0
"""Standard deviations beyond which a coefficient is kept; noise alone exceeds them once in 370."""
TRUST_READING_SIGMAS = 4.0
"""Standard deviations beyond which the reading replaces the filtered value, as at a jump."""


def quieted(x: Array, sigma: Array) -> Array:
    """A record (n, m) with its white noise of standard deviation `sigma` (m,) removed."""
    spectrum = dct(x, type=2, norm="ortho", axis=0)
    kept = np.abs(spectrum) > KEEP_SIGMAS * sigma
    kept[0] = True
    quiet = idct(np.where(kept, spectrum, 0.0), type=2, norm="ortho", axis=0)
    return np.asarray(np.where(np.abs(x - quiet) > TRUST_READING_SIGMAS * sigma, x, quiet), dtype=np.float64)
