"""What the edges of a switching leg lose to dead time, as numba kernels; they know nothing of recordings.

A leg that switches against its current waits for the dead time t_d; one that switches with it commutates at once,
as fast as the current i charges the output capacitances of both its devices, together C: dv/dt = i / C. At
i_k = C V_dc / t_d the swing just ends within t_d; below, the other switch cuts it short. In parts of t_d, the mean of
the edge is late by

    late(x) = 1 - r x where x <= 0,    1 - A(x) / x up to x = 1,    1 / (2x) beyond,    x = i / i_k

for the current i out of the leg at a falling edge and into it at a rising one; the leg loses
V_dt (late(-x_rising) - late(x_falling)). A is the integral of the node's part u of the bus over the part x of the
charge that has flown. With constant capacitances u = x and A = x^2 / 2. Those of junctions fall as v^-m with the
voltage v across each, and are largest at both rails:

    x(u) = (u^(1-m) + 1 - (1-u)^(1-m)) / 2

Against its current, a leg's node stands until the switch that closes has taken that current over, which takes the
longer the larger it is: r (B. J. Baliga, Fundamentals of Power Semiconductor Devices, doi:10.1007/978-0-387-47314-7).

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

Legs = tuple[float, float, float]

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
def _late(knees: float, leg: float, brake: float, before: float, takeover: float, early: Array) -> float:
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
    takeover : float
        Of the dead time, that a switch takes to take over a knee's current.
    early : array
        See `swung_early`.
    """
    x = knees * leg
    if x <= 0.0:
        return leg - takeover * knees
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
    v_ab: Array,
    i_ab: Array,
    volts: Array,
    legs: Array,
    knees_per_a: float,
    pull: Array,
    cycles: int,
    takeover: float,
    early: Array,
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
    takeover : float
        r: of the dead time, that a switch takes to take over the current of a knee.
    early : array
        See `swung_early`.
    """
    n = i_ab.shape[0]
    out = np.empty_like(v_ab)
    by_a = (pull[0, 0], pull[0, 1], pull[0, 2])
    by_b = (pull[1, 1], pull[1, 2], pull[1, 0])
    by_c = (pull[2, 2], pull[2, 0], pull[2, 1])
    up, down = (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)
    for k in range(n):
        after = min(k + 1, n - 1)
        a, b, c = phases_of(knees_per_a * i_ab[k, 0], knees_per_a * i_ab[k, 1])
        per_cycle = knees_per_a / cycles
        step_a, step_b, step_c = phases_of(
            per_cycle * (i_ab[after, 0] - i_ab[k, 0]), per_cycle * (i_ab[after, 1] - i_ab[k, 1])
        )
        v_a, v_b, v_c = phases_of(v_ab[k, 0], v_ab[k, 1])
        lost_a, lost_b, lost_c = 0.0, 0.0, 0.0
        for _ in range(cycles):
            for _ in range(PASSES):
                (a0, b0, c0), (a1, b1, c1) = up, down
                a_up, a_down = _edges(
                    a, step_a, by_a, (v_a, v_b, v_c), (a0, b0, c0), (a1, b1, c1), volts[k], legs[0], takeover, early
                )
                b_up, b_down = _edges(
                    b, step_b, by_b, (v_b, v_c, v_a), (b0, c0, a0), (b1, c1, a1), volts[k], legs[1], takeover, early
                )
                c_up, c_down = _edges(
                    c, step_c, by_c, (v_c, v_a, v_b), (c0, a0, b0), (c1, a1, b1), volts[k], legs[2], takeover, early
                )
                up, down = (a_up, b_up, c_up), (a_down, b_down, c_down)
                moved_up = max(abs(a_up - a0), abs(b_up - b0), abs(c_up - c0))
                if max(moved_up, abs(a_down - a1), abs(b_down - b1), abs(c_down - c1)) < SETTLED:
                    break
            lost_a += (up[0] - down[0]) / cycles
            lost_b += (up[1] - down[1]) / cycles
            lost_c += (up[2] - down[2]) / cycles
            a, b, c = a + step_a, b + step_b, c + step_c
        alpha, beta = vector_of(lost_a, lost_b, lost_c)
        out[k, 0] = volts[k] * alpha
        out[k, 1] = volts[k] * beta
    return out


@njit(cache=True, nogil=True, inline="always")
def _edges(
    valley: float,
    step: float,
    pull: Legs,
    commanded: Legs,
    rises: Legs,
    falls: Legs,
    volts: float,
    leg: float,
    takeover: float,
    early: Array,
) -> tuple[float, float]:
    """How late a leg's rise and fall of a period are, in parts of the dead time, from what all were before.

    Of three legs, the leg's own comes first. Times are told by the volts that a pulse gains or loses by them.
    """
    drift = step
    for y in range(3):
        drift -= pull[y] * (commanded[y] - volts * (rises[y] - falls[y]))
    swing_up, swing_down = volts * min(leg, 2.0 * rises[0]), volts * min(leg, 2.0 * falls[0])
    rising, falling = valley + 0.25 * drift, valley + 0.75 * drift
    for y in range(1, 3):
        ahead = 0.5 * (commanded[y] - commanded[0])
        rising += pull[y] * _ramp(volts * rises[y] - ahead, swing_up)
        falling += pull[y] * (ahead + volts * (rises[0] - rises[y]) - _ramp(volts * falls[y] + ahead, swing_down))
    # The leg's own swing brakes the current that drives it.
    brake = pull[0] * volts / 12.0
    rise = _late(-rising, leg, brake, rises[0], takeover, early)
    return rise, _late(falling, leg, brake, falls[0], takeover, early)
