"""The kernel that takes an inverter's share out of a voltage, sample by sample; its shape is known here."""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.analysis._samples import Samples
from orchestrator.numerics.types import Array


@njit(cache=True, nogil=True, fastmath=True)
def take_out(
    i_ab: Samples, start: int, frame: tuple[float, float], knots: Array, volts: Array, areas: Array, v: Array
) -> None:
    """Take from v, rows d and q, what each phase loses while its current runs straight from sample to sample.

    The mean of the shape from one current to the next is the difference of its integrals over theirs: a current that
    passes zero within a sample loses neither the one sign's voltage nor the other's.
    """
    cos, sin = frame
    half = np.sqrt(0.75)
    last = i_ab.shape[0] - 1
    before, area = np.zeros(3), np.zeros(3)
    kept = np.zeros(3)
    for k in range(-1, v.shape[1]):
        row = min(start + k + 1, last)
        alpha, beta = np.float64(i_ab[row, 0]), np.float64(i_ab[row, 1])
        for phase in range(3):
            i = alpha if phase == 0 else (-0.5 * alpha + half * beta if phase == 1 else -0.5 * alpha - half * beta)
            now = _area(abs(i), knots, volts, areas)
            step = i - before[phase]
            if abs(step) > 1e-6 * knots[0]:
                kept[phase] = (now - area[phase]) / step
            before[phase], area[phase] = i, now
        if k < 0:
            kept[:] = 0.0
            continue
        a, b = (2.0 * kept[0] - kept[1] - kept[2]) / 3.0, (kept[1] - kept[2]) / (2.0 * half)
        v[0, k] -= cos * a + sin * b
        v[1, k] -= cos * b - sin * a


@njit(cache=True, nogil=True, fastmath=True)
def _area(size: float, knots: Array, volts: Array, areas: Array) -> float:
    """Integral of the shape from zero to a current."""
    n = len(knots)
    if size >= knots[n - 1]:
        return float(areas[n - 1] + volts[n - 1] * (size - knots[n - 1]))
    above = 0
    while size > knots[above]:
        above += 1
    low, low_v, so_far = (knots[above - 1], volts[above - 1], areas[above - 1]) if above > 0 else (0.0, 0.0, 0.0)
    part = size - low
    return float(so_far + part * (low_v + 0.5 * part * (volts[above] - low_v) / (knots[above] - low)))
