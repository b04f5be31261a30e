"""What the edges of a switching leg lose to dead time, as numba kernels; they know nothing of recordings.

A leg that switches against its current waits for the dead time t_d; one that switches with it commutates at once,
as fast as the current i charges the output capacitances of both its devices, together C: dv/dt = i / C. At
i_k = C V_dc / t_d the swing just ends within t_d; below, the other switch cuts it short. In parts of t_d, the mean of
the edge is late by

    late(x) = 1 where x <= 0,    1 - x/2 up to x = 1,    1 / (2x) beyond,    x = i / i_k

for the current i out of the leg at a falling edge and into it at a rising one; the leg loses
V_dt (late(-x_rising) - late(x_falling)).

Edges do not see the mean current: all legs of a symmetric carrier rise about a quarter and fall about three quarters
through its period T, and in phase x the ripple there is -+ T / (12 L) sum_y |v_x - v_y|, from the volt-seconds of the
legs that switched before.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array


@njit(cache=True, nogil=True)
def _late(x: float) -> float:
    """Delay of an edge's mean in parts of the dead time, at a current x that helps the edge, in knees."""
    if x <= 0.0:
        return 1.0
    return 1.0 - 0.5 * x if x < 1.0 else 0.5 / x


@njit(cache=True, nogil=True)
def lost_at_edges(v_ab: Array, i_ab: Array, volts: Array, knees_per_a: float, knees_per_v: float, cycles: int) -> Array:
    """Voltage (n, 2) that dead time takes over each interval.

    Parameters
    ----------
    v_ab, i_ab : array, shape (n, 2)
    volts : array, shape (n,)
        V_dt in each interval.
    knees_per_a : float
        1 / i_k.
    knees_per_v : float
        T / (12 L) in knees: the ripple that a volt between two phases makes at an edge.
    cycles : int
        Carrier periods in an interval.
    """
    n = i_ab.shape[0]
    out = np.empty_like(v_ab)
    now, step, felt, lost = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        after = min(k + 1, n - 1)
        now[0], now[1], now[2] = phases_of(knees_per_a * i_ab[k, 0], knees_per_a * i_ab[k, 1])
        step[0], step[1], step[2] = phases_of(
            knees_per_a * (i_ab[after, 0] - i_ab[k, 0]), knees_per_a * (i_ab[after, 1] - i_ab[k, 1])
        )
        felt[0], felt[1], felt[2] = phases_of(v_ab[k, 0], v_ab[k, 1])
        for x in range(3):
            middle = now[x] + 0.5 * step[x]
            felt[x] -= volts[k] * (_late(-middle) - _late(middle))
        for x in range(3):
            others = abs(felt[x] - felt[0]) + abs(felt[x] - felt[1]) + abs(felt[x] - felt[2])
            ripple = knees_per_v * others
            lost[x] = 0.0
            for cycle in range(cycles):
                rising = now[x] + (cycle + 0.25) / cycles * step[x] - ripple
                falling = now[x] + (cycle + 0.75) / cycles * step[x] + ripple
                lost[x] += (_late(-rising) - _late(falling)) / cycles
        alpha, beta = vector_of(lost[0], lost[1], lost[2])
        out[k, 0] = volts[k] * alpha
        out[k, 1] = volts[k] * beta
    return out
