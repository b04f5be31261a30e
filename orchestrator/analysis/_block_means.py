"""One pass over a sweep's waveforms: current and running integrals, averaged over short blocks.

All results are in the stator frame.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import Samples, for_kernels
from orchestrator.numerics.types import Array


def block_means(
    i_ab: Samples, v_ab: Samples, *, sampling_s: float, delay: float, block: int
) -> tuple[Array, Array, Array]:
    """Means over blocks of the current [A], of its integral [As] and of the acting voltage's [Vs], shape (blocks, 2).

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    delay : float
        v[k] acts from t_k + `delay` Ts on; before anything has acted, the first command stands for it.
    block : int
        Samples per block; an incomplete last block is dropped.
    """
    i, v = for_kernels(i_ab, v_ab)
    whole = math.floor(delay)
    out = np.zeros((3, len(i) // block, 2))
    _accumulate(i, v, sampling_s, whole, float(delay - whole), block, out)
    return out[0], out[1], out[2]


@njit(cache=True, nogil=True)
def _accumulate(
    i_ab: Samples, v_ab: Samples, sampling_s: float, whole: int, part: float, block: int, out: Array
) -> None:
    for axis in range(2):
        charge, impulse = 0.0, 0.0
        for b in range(out.shape[1]):
            current, charges, impulses = 0.0, 0.0, 0.0
            for k in range(b * block, (b + 1) * block):
                i = np.float64(i_ab[k, axis])
                v = (1.0 - part) * v_ab[max(k - whole, 0), axis] + part * v_ab[max(k - whole - 1, 0), axis]
                current += i
                # The current's integral by trapezoids; the voltage acts from its sample on.
                charges += charge + 0.5 * i
                impulses += impulse
                charge += i
                impulse += v
            out[0, b, axis] = current / block
            out[1, b, axis] = sampling_s * charges / block
            out[2, b, axis] = sampling_s * impulses / block
