"""Flux linkage and current over time without the sensors' noise: fast from the voltage, slow from the map.

psi(i) alone has the current's noise, which makes a hysteresis operator reverse; the integral of v - R i alone drifts.
The observer follows the integral and approaches psi(i) with a time constant of a few ms.

The current comes from another integral, which takes its own current for the drop and approaches psi(i) ten times more
slowly. A lag tau of a sensor is undone by tau di/dt: with a current that follows the readings in T, it would multiply
their noise by 1 + tau / T - R tau / L at frequencies above 1 / T, which no noise model of the readings has.
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
        slow_pull = 1.0 - math.exp(-0.1 * ts / time_constant_s)
        own = (0.0, 0.0)
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
            i_a, i_b = i_ab[k]
            if k == first:
                out[k], own = psi[k], (psi[k, 0], psi[k, 1])
            else:
                half = 0.25 * (resistance_ohm[k - 1] + resistance_ohm[k])
                for axis in range(2):
                    p = out[k - 1, axis] + ts * (v_ab[k - 1, axis] - half * (i_ab[k - 1, axis] + i_ab[k, axis]))
                    out[k, axis] = p + pull * (psi[k, axis] - p)
                # Half a sample's decay by the inductance at the reading, for the drop of the mean current.
                rise_a = ts * (v_ab[k - 1, 0] - 2.0 * half * current[k - 1, 0])
                rise_b = ts * (v_ab[k - 1, 1] - 2.0 * half * current[k - 1, 1])
                more_a, more_b = _current_of(rise_a, rise_b, c, s, inductance[k], min_determinant)
                p_a = own[0] + rise_a - half * ts * more_a
                p_b = own[1] + rise_b - half * ts * more_b
                own = p_a + slow_pull * (psi[k, 0] - p_a), p_b + slow_pull * (psi[k, 1] - p_b)
            d_a, d_b = _current_of(own[0] - psi[k, 0], own[1] - psi[k, 1], c, s, inductance[k], min_determinant)
            bearable = largest / max(largest, math.hypot(d_a, d_b), 1e-300)
            current[k, 0] = i_a + bearable * d_a
            current[k, 1] = i_b + bearable * d_b
    return psi, out, current


@njit(cache=True, nogil=True, inline="always")
def _current_of(
    x: float, y: float, c: float, s: float, inductance: Array, min_determinant: float
) -> tuple[float, float]:
    """L^-1 of a flux (x, y) in the stator frame, with L in the frame at cosine c and sine s."""
    d, q = c * x + s * y, -s * x + c * y
    det = max(inductance[0] * inductance[2] - inductance[1] ** 2, min_determinant)
    i_d = (inductance[2] * d - inductance[1] * q) / det
    i_q = (inductance[0] * q - inductance[1] * d) / det
    return c * i_d - s * i_q, s * i_d + c * i_q
