"""Flux linkage and current over time without the sensors' noise: fast from the voltage, slow from the map.

psi(i) alone carries the current's noise, which drives a hysteresis operator to and fro; the integral of v - R i
alone drifts. The observer follows the integral and is drawn to psi(i) with a time constant of 5 ms. Fits nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TIME_CONSTANT_S = 0.005


@njit(cache=True, nogil=True)
def smooth_flux(psi_ab: Array, v_ab: Array, i_ab: Array, resistance_ohm: Array, ts: float) -> Array:
    """Flux linkage in the stator frame without the current's noise, shape (n, 2) [Wb].

    Parameters
    ----------
    psi_ab : array, shape (n, 2)
        The map's flux at the measured current.
    v_ab, i_ab : array, shape (n, 2)
        Impressed voltage and stator current.
    resistance_ohm : array, shape (n,)
    """
    n = psi_ab.shape[0]
    out = np.empty((n, 2))
    pull = 1.0 - math.exp(-ts / _TIME_CONSTANT_S)
    for axis in range(2):
        out[0, axis] = psi_ab[0, axis]
        for k in range(1, n):
            r = 0.25 * (resistance_ohm[k - 1] + resistance_ohm[k])
            p = out[k - 1, axis] + ts * (v_ab[k - 1, axis] - r * (i_ab[k - 1, axis] + i_ab[k, axis]))
            out[k, axis] = p + pull * (psi_ab[k, axis] - p)
    return out
