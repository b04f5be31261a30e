"""Inverter voltage error per phase over waveforms: its integrals per unit, and the voltage less the error.

The error is an odd function of the phase current, linear between knots and constant beyond the last; it covers dead
times, drops and the clamping at zero current, and is linear in the values at the knots.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import Samples, dq_of, for_kernels, phases_of, vector_of
from orchestrator.numerics.types import Array


def shape_integrals(i_ab: Samples, knots_a: Array, sampling_s: float, block: int, blocks: int) -> Array:
    """Block means of the running integral of T hat_k(i_abc), shape (blocks, knots, 2), stator frame [s].

    Parameters
    ----------
    i_ab : array, shape (n, 2)
        Measured current [A].
    knots_a : array, shape (k,)
        Knots of the error over the phase current [A], increasing and positive.
    """
    (i,) = for_kernels(i_ab)
    return _integrate(i, knots_a, sampling_s, block, blocks)


@njit(cache=True, nogil=True)
def _integrate(i_ab: Samples, knots: Array, sampling_s: float, block: int, blocks: int) -> Array:
    n = len(knots)
    out = np.zeros((blocks, n, 2))
    total, share = np.zeros((n, 2)), np.zeros((n, 3))
    for b in range(blocks):
        for k in range(b * block, (b + 1) * block):
            currents = phases_of(np.float64(i_ab[k, 0]), np.float64(i_ab[k, 1]))
            for phase in range(3):
                for m in range(n):
                    share[m, phase] = 0.0
                size, sign = abs(currents[phase]), np.sign(currents[phase])
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
                alpha, beta = vector_of(share[m, 0], share[m, 1], share[m, 2])
                # A trapezoid: half of this sample's share now, half after the instant.
                out[b, m, 0] += (total[m, 0] + 0.5 * sampling_s * alpha) / block
                out[b, m, 1] += (total[m, 1] + 0.5 * sampling_s * beta) / block
                total[m, 0] += sampling_s * alpha
                total[m, 1] += sampling_s * beta
    return out


@njit(cache=True, nogil=True, fastmath=True)
def take_out(
    i_ab: Samples, start: int, frame: tuple[float, float], knots: Array, volts: Array, areas: Array, v: Array
) -> None:
    """Subtract the inverter's error from v, rows d and q, with each phase current linear between samples.

    The mean error from one current to the next is the difference of the error's integrals over the current step, so a
    zero crossing within a sample is weighted correctly.
    """
    cos, sin = frame
    last = i_ab.shape[0] - 1
    previous, area = np.zeros(3), np.zeros(3)
    loss = np.zeros(3)
    for k in range(-1, v.shape[1]):
        row = min(start + k + 1, last)
        currents = phases_of(np.float64(i_ab[row, 0]), np.float64(i_ab[row, 1]))
        for phase in range(3):
            new_area = _area(abs(currents[phase]), knots, volts, areas)
            step = currents[phase] - previous[phase]
            # A constant current keeps its previous error: the step would be a zero divisor.
            if abs(step) > 1e-6 * knots[0]:
                loss[phase] = (new_area - area[phase]) / step
            previous[phase], area[phase] = currents[phase], new_area
        if k < 0:
            loss[0], loss[1], loss[2] = 0.0, 0.0, 0.0
            continue
        alpha, beta = vector_of(loss[0], loss[1], loss[2])
        d, q = dq_of(alpha, beta, cos, sin)
        v[0, k] -= d
        v[1, k] -= q


@njit(cache=True, nogil=True, fastmath=True)
def _area(size: float, knots: Array, volts: Array, areas: Array) -> float:
    """Integral of the error from zero to a current [VA]."""
    n = len(knots)
    if size >= knots[n - 1]:
        return float(areas[n - 1] + volts[n - 1] * (size - knots[n - 1]))
    above = 0
    while size > knots[above]:
        above += 1
    low, low_v, so_far = (knots[above - 1], volts[above - 1], areas[above - 1]) if above > 0 else (0.0, 0.0, 0.0)
    part = size - low
    return float(so_far + part * (low_v + 0.5 * part * (volts[above] - low_v) / (knots[above] - low)))
