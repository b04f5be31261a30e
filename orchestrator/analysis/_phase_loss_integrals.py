"""What an inverter takes from each phase, as a function of its current: integrals of its shape over a capture.

The shape is odd, straight between knots and constant beyond the last, so whatever dead times, drops and the clamping
at zero current make of it, it is linear in the values at the knots. Nothing is fitted here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.analysis._samples import Samples, for_kernels
from orchestrator.numerics.types import Array


def step_integrals(i_ab: Samples, knots_a: Array, sampling_s: float, block: int, blocks: int) -> Array:
    """Block means of the running integral of T hat_k(i_abc), shape (blocks, knots, 2), stator frame [s].

    Parameters
    ----------
    i_ab : array, shape (n, 2)
        Measured current [A].
    knots_a : array, shape (k,)
        Phase currents at which the shape is known [A], increasing and positive.
    """
    (i,) = for_kernels(i_ab)
    return _integrate(i, knots_a, sampling_s, block, blocks)


@njit(cache=True, nogil=True)
def _integrate(i_ab: Samples, knots: Array, sampling_s: float, block: int, blocks: int) -> Array:
    n = len(knots)
    out = np.zeros((blocks, n, 2))
    total, share = np.zeros((n, 2)), np.zeros((n, 3))
    half = np.sqrt(0.75)
    for b in range(blocks):
        for k in range(b * block, (b + 1) * block):
            alpha, beta = np.float64(i_ab[k, 0]), np.float64(i_ab[k, 1])
            share[:] = 0.0
            for phase in range(3):
                i = alpha if phase == 0 else (-0.5 * alpha + half * beta if phase == 1 else -0.5 * alpha - half * beta)
                size, sign = abs(i), np.sign(i)
                if size >= knots[n - 1]:
                    share[n - 1, phase] = sign
                    continue
                above = 0
                while size > knots[above]:
                    above += 1
                low = knots[above - 1] if above > 0 else 0.0
                place = (size - low) / (knots[above] - low)
                share[above, phase] = sign * place
                if above > 0:
                    share[above - 1, phase] = sign * (1.0 - place)
            for m in range(n):
                d = sampling_s * (2.0 * share[m, 0] - share[m, 1] - share[m, 2]) / 3.0
                q = sampling_s * (share[m, 1] - share[m, 2]) / (2.0 * half)
                # A trapezoid: half of this sample's share now, half after the instant.
                out[b, m, 0] += total[m, 0] + 0.5 * d
                out[b, m, 1] += total[m, 1] + 0.5 * q
                total[m, 0] += d
                total[m, 1] += q
        out[b] /= block
    return out
