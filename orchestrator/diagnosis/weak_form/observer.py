"""Flux linkage and current over time without the sensors' noise: fast from the voltage, slow from the map.

psi(i) alone has the current's noise, which makes a hysteresis operator reverse; the integral of v - R i alone drifts.
The observer follows the integral and approaches psi(i) with a time constant of a few ms.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


@njit(cache=True, nogil=True)
def smooth_flux(
    psi_dq: Array,
    inductance: Array,
    v_ab: Array,
    i_ab: Array,
    resistance_ohm: Array,
    turn: Array,
    pm_flux: float,
    starts: NDArray[np.int64],
    interval_s: Array,
    time_constant_s: float,
) -> tuple[Array, Array, Array]:
    """Flux linkage with and without noise, and the current of the latter, each (n, 2).

    Parameters
    ----------
    psi_dq : array, shape (n, 2)
        The map's flux at the measured current, without the magnet's, in the frame rotated by `turn` [Wb].
    inductance : array, shape (n, 3)
        L_dd, L_dq, L_qq there [H].
    v_ab, i_ab : array, shape (n, 2)
        Impressed voltage [V] and stator current [A].
    resistance_ohm : array, shape (n,)
    turn : array, shape (n, 2) or (segments, 2)
        Cosine and sine of the rotor's angle, per sample or per segment.
    starts : array of int64, shape (segments + 1,)
        Bounds of the segments, in each of which the observer starts anew.
    interval_s : array, shape (segments,)
        Sampling interval [s].

    Returns
    -------
    psi_ab, smooth_ab : array
        Flux linkage in the stator frame, magnet included [Wb].
    i_smooth_ab : array
        i + L^-1 (psi_smooth - psi(i)) [A]; differs from i by no more than the largest i, for nearly flat trial maps.
    """
    n = psi_dq.shape[0]
    psi = np.empty((n, 2))
    out = np.empty((n, 2))
    current = np.empty((n, 2))
    segments = starts.shape[0] - 1
    is_fixed = turn.shape[0] == segments
    for m in range(segments):
        first, end = starts[m], starts[m + 1]
        ts = interval_s[m]
        pull = 1.0 - math.exp(-ts / time_constant_s)
        mean_d = 0.0
        mean_q = 0.0
        largest = 0.0
        for k in range(first, end):
            mean_d += inductance[k, 0] / (end - first)
            mean_q += inductance[k, 2] / (end - first)
            largest = max(largest, math.hypot(i_ab[k, 0], i_ab[k, 1]))
        min_determinant = 1e-3 * mean_d * mean_q
        for k in range(first, end):
            c, s = turn[m if is_fixed else k]
            d = psi_dq[k, 0] + pm_flux
            psi[k, 0] = c * d - s * psi_dq[k, 1]
            psi[k, 1] = s * d + c * psi_dq[k, 1]
            for axis in range(2):
                if k == first:
                    out[k, axis] = psi[k, axis]
                else:
                    r = 0.25 * (resistance_ohm[k - 1] + resistance_ohm[k])
                    p = out[k - 1, axis] + ts * (v_ab[k - 1, axis] - r * (i_ab[k - 1, axis] + i_ab[k, axis]))
                    out[k, axis] = p + pull * (psi[k, axis] - p)
            x = out[k, 0] - psi[k, 0]
            y = out[k, 1] - psi[k, 1]
            step_d = c * x + s * y
            step_q = -s * x + c * y
            det = max(inductance[k, 0] * inductance[k, 2] - inductance[k, 1] ** 2, min_determinant)
            i_d = (inductance[k, 2] * step_d - inductance[k, 1] * step_q) / det
            i_q = (inductance[k, 0] * step_q - inductance[k, 1] * step_d) / det
            bearable = largest / max(largest, math.hypot(i_d, i_q), 1e-300)
            i_d *= bearable
            i_q *= bearable
            current[k, 0] = i_ab[k, 0] + c * i_d - s * i_q
            current[k, 1] = i_ab[k, 1] + s * i_d + c * i_q
    return psi, out, current
