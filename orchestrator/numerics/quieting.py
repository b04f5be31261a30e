"""A record without its readings' white noise: what stands out of the noise in its cosine spectrum.

Hard thresholding after D. L. Donoho and I. M. Johnstone, Biometrika 81 (1994), doi:10.1093/biomet/81.3.425. Their
threshold sqrt(2 ln n) lets no noise pass; three standard deviations let a little of it pass and keep more of a bend.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct, idct

from orchestrator.numerics.types import Array

_TOLD = 3.0
"""Standard deviations beyond which a coefficient is kept: of noise alone, one in 370."""
_CLEARLY = 4.0
"""Standard deviations beyond which a reading is believed, not what the spectrum makes of it: at a jump."""


def quieted(x: Array, sigma: Array) -> Array:
    """A record of shape (n, m) whose readings scatter by `sigma` (m,), without that scatter."""
    spectrum = dct(x, type=2, norm="ortho", axis=0)
    told = np.abs(spectrum) > _TOLD * sigma
    told[0] = True
    quiet = idct(np.where(told, spectrum, 0.0), type=2, norm="ortho", axis=0)
    return np.asarray(np.where(np.abs(x - quiet) > _CLEARLY * sigma, x, quiet), dtype=np.float64)
