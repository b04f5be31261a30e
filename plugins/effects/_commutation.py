"""What the edges of a switching leg lose to dead time, as numba kernels; they know nothing of recordings.

A leg that switches against its current waits for the dead time t_d; one that switches with it commutates at once,
as fast as the current i charges the output capacitances of both its devices, together C: dv/dt = i / C. At
i_k = C V_dc / t_d the swing just ends within t_d; below, the other switch cuts it short. In parts of t_d, the mean of
the edge is late by

    late(x) = 1 where x <= 0,    1 - A(x) / x up to x = 1,    1 / (2x) beyond,    x = i / i_k

for the current i out of the leg at a falling edge and into it at a rising one; the leg loses
V_dt (late(-x_rising) - late(x_falling)). A is the integral of the node's part u of the bus over the part x of the
charge that has flown. With constant capacitances u = x and A = x^2 / 2. Those of junctions fall as v^-m with the
voltage v across each, and are largest at both rails:

    x(u) = (u^(1-m) + 1 - (1-u)^(1-m)) / 2

Source: S. M. Sze, K. K. Ng, Physics of Semiconductor Devices, section 2.2.2 (m = 1/2 of an abrupt junction, 1/3 of a
graded one; more of a compensated one), doi:10.1002/0470068329.

x is not of the mean current. Each leg's edge steps the voltage on the other phases; rises are about a quarter, falls
about three quarters through a symmetric carrier's period. With the time of its edge, dead time included, known of every
leg, the current in a swing is that of the valley or the peak before it and a ramp from every edge that comes before the
swing ends. How late one edge is decides how late others are: few passes settle it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array

PASSES = 4
SETTLED = 5e-4
"""Of the dead time: what an edge that is so much later does to the others is nothing beside their own knees."""


@lru_cache(maxsize=32)
def swung_early(grading: float, entries: int = 256) -> Array:
    """Table of A(x) / x over x = 0..1: the part of the dead time that a swing which it cuts short is early."""
    u = np.linspace(0.0, 1.0, 2049)[1:]
    left, power = 1.0 - u, 1.0 - grading
    x = 0.5 * (u**power + 1.0 - left**power)
    below = 0.5 * (u + (u ** (1.0 + power) + left ** (1.0 + power) - 1.0) / (1.0 + power))
    early = np.interp(np.linspace(0.0, 1.0, entries + 1), np.append(0.0, x), np.append(0.0, u - below / x))
    return np.asarray(early, dtype=np.float64)


@njit(cache=True, nogil=True, inline="always")
def _early(x: float, table: Array) -> float:
    """`swung_early` at x = 0..1."""
    place = x * (table.shape[0] - 1)
    m = min(int(place), table.shape[0] - 2)
    return float(table[m] + (place - m) * (table[m + 1] - table[m]))


@njit(cache=True, nogil=True, inline="always")
def _late(knees: float, leg: float, brake: float, before: float, early: Array) -> float:
    """Delay of an edge's mean in parts of the dead time.

    Parameters
    ----------
    knees : float
        The current that helps the edge.
    leg : float
        The leg's own dead time.
    brake : float
        By how much a swing of all the dead time brakes the current that drives it.
    before : float
        The delay as it was believed, which tells how long the swing is.
    early : array
        See `swung_early`.
    """
    x = knees * leg
    if x <= 0.0:
        return leg
    swing = min(leg, 2.0 * before)
    braked = 1.0 + brake * swing * swing
    if x >= braked:
        return leg * 0.5 * braked / x
    return leg * (1.0 - _early(x / braked, early))


@njit(cache=True, nogil=True, inline="always")
def _ramp(start: float, width: float) -> float:
    """Mean of max(0, s - start) over a swing 0..width, each instant weighted by what is left of it."""
    if start >= width:
        return 0.0
    if start <= 0.0:
        return width / 3.0 - start
    left = width - start
    return left * left * left / (3.0 * width * width)


@njit(cache=True, nogil=True)
def lost_at_edges(
    v_ab: Array, i_ab: Array, volts: Array, legs: Array, knees_per_a: float, pull: Array, cycles: int, early: Array
) -> Array:
    """Voltage (n, 2) that dead time takes over each interval.

    Parameters
    ----------
    v_ab, i_ab : array, shape (n, 2)
    volts : array, shape (n,)
        V_dt in each interval: dead time as a part of the carrier's period, times V_dc.
    legs : array, shape (3,)
        Each leg's own dead time in parts of that.
    knees_per_a : float
        1 / i_k.
    pull : array, shape (3, 3)
        By how many knees a volt on one phase's terminal moves each current over a carrier's period.
    cycles : int
        Carrier periods in an interval.
    early : array
        See `swung_early`.
    """
    n = i_ab.shape[0]
    out = np.empty_like(v_ab)
    valley, step, commanded, lost = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    up, down = np.ones(3), np.ones(3)
    for k in range(n):
        after = min(k + 1, n - 1)
        valley[0], valley[1], valley[2] = phases_of(knees_per_a * i_ab[k, 0], knees_per_a * i_ab[k, 1])
        step[0], step[1], step[2] = phases_of(
            knees_per_a / cycles * (i_ab[after, 0] - i_ab[k, 0]), knees_per_a / cycles * (i_ab[after, 1] - i_ab[k, 1])
        )
        commanded[0], commanded[1], commanded[2] = phases_of(v_ab[k, 0], v_ab[k, 1])
        for x in range(3):
            lost[x] = 0.0
        for _ in range(cycles):
            _settle(valley, step, commanded, volts[k], legs, pull, early, up, down)
            for x in range(3):
                lost[x] += (up[x] - down[x]) / cycles
                valley[x] += step[x]
        alpha, beta = vector_of(lost[0], lost[1], lost[2])
        out[k, 0] = volts[k] * alpha
        out[k, 1] = volts[k] * beta
    return out


@njit(cache=True, nogil=True, inline="always")
def _settle(
    valley: Array,
    step: Array,
    commanded: Array,
    volts: float,
    legs: Array,
    pull: Array,
    early: Array,
    up: Array,
    down: Array,
) -> None:
    """How late the three rises and falls of a period are, in parts of the dead time, from what they were before.

    Times are told by the volts that a pulse gains or loses by them.
    """
    for _ in range(PASSES):
        rises, falls = (up[0], up[1], up[2]), (down[0], down[1], down[2])
        mean_0 = commanded[0] - volts * (up[0] - down[0])
        mean_1 = commanded[1] - volts * (up[1] - down[1])
        mean_2 = commanded[2] - volts * (up[2] - down[2])
        moved = 0.0
        for x in range(3):
            drift = step[x] - pull[x, 0] * mean_0 - pull[x, 1] * mean_1 - pull[x, 2] * mean_2
            rising = valley[x] + 0.25 * drift
            falling = valley[x] + 0.75 * drift
            swing_up = volts * min(legs[x], 2.0 * rises[x])
            swing_down = volts * min(legs[x], 2.0 * falls[x])
            for y in range(3):
                if y != x:
                    ahead = 0.5 * (commanded[y] - commanded[x])
                    rising += pull[x, y] * _ramp(volts * rises[y] - ahead, swing_up)
                    late = ahead + volts * (rises[x] - rises[y])
                    falling += pull[x, y] * (late - _ramp(volts * falls[y] + ahead, swing_down))
            # The leg's own swing brakes the current that drives it.
            brake = pull[x, x] * volts / 12.0
            up[x] = _late(-rising, legs[x], brake, rises[x], early)
            down[x] = _late(falling, legs[x], brake, falls[x], early)
            moved = max(moved, abs(up[x] - rises[x]), abs(down[x] - falls[x]))
        if moved < SETTLED:
            return
