"""Waveforms as the kernels take them: in one piece and one precision, widened sample by sample where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.floating[Any]]


def for_kernels(*waveforms: Samples) -> tuple[Samples, ...]:
    """The same arrays C-contiguous, all of float32 or all of float64.

    A copy in double precision costs as much as half a pass, and kernels are compiled for these two kinds only.
    """
    single = all(x.dtype == np.float32 for x in waveforms)
    if single:
        return tuple(np.ascontiguousarray(x, dtype=np.float32) for x in waveforms)
    return tuple(np.ascontiguousarray(x, dtype=np.float64) for x in waveforms)
