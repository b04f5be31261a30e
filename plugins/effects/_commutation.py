"""Voltage lost to dead time at the edges of a switching leg, as numba kernels.

A leg that switches against its current waits for the dead time t_d; one that switches with it commutates at once,
as fast as the current i charges the output capacitances of both its devices, together C: dv/dt = i / C. At
i_k = C V_dc / t_d the swing just ends within t_d; below, the other switch cuts it short. In units of t_d, the mean of
the edge is delayed by

    late = int_0^1 (1 - u) ds,    dq/ds = x = i / i_k,    u(q) the node's voltage over the bus, 0 <= q <= 1

for the current i out of the leg at a falling edge and into it at a rising one, s in units of t_d, q the charge moved
over a full swing's; the leg loses V_dt (late_rising - late_falling). With constant capacitances u = q. Those of
junctions fall as v^-m with the voltage v across each, and are largest at both rails:

    q(u) = (u^(1-m) + 1 - (1-u)^(1-m)) / 2

Against its current, a leg's node waits until the closing switch has taken over that current, in a time proportional to
it: late = 1 - r x (B. J. Baliga, Fundamentals of Power Semiconductor Devices, doi:10.1007/978-0-387-47314-7).

Source: S. M. Sze, K. K. Ng, Physics of Semiconductor Devices, section 2.2.2 (m = 1/2 of an abrupt junction, 1/3 of a
graded one; more of a compensated one), doi:10.1002/0470068329.

x is the instantaneous current, not the mean. Each leg's edge steps the voltage on the other phases; rises are at about
a quarter, falls at about three quarters of a symmetric carrier's period. Given all edge times, dead time included, the
current in a swing is that of the preceding valley or peak, plus a ramp from every edge before the swing's end, minus
the effect of the node's rise. Within a microsecond a winding with its cable does not act like its inductance;
`Swing.yielding` is the part of that response. The delays of edges depend on each other: a few passes converge.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from plugins.effects._vectors import Starts

Legs = tuple[float, float, float]

_SQRT3 = math.sqrt(3.0)

QUICK_SWING_KNEES = 3.0
"""Current over i_k above which a swing is computed from its mean current: it ends within a third of the dead time."""

SWING_STEPS = 5
"""Integration steps of a swing with a constant current; a dead time has at least twice as many."""

MAX_EDGE_PASSES = 4
EDGE_TOLERANCE_RATIO = 1e-3
"""Shift of an edge over the dead time below which the passes end, as its effect on the others is negligible."""


class Swing(NamedTuple):
    """Parameters of a leg's node between a command and the end of its dead time."""

    lines: Array
    """See `swing_lines`."""
    takeover: float = 0.0
    """r, the time in which a switch takes over the current i_k, over the dead time."""
    yielding: float = 0.0
    """Response of the currents within a swing, relative to the inductance's; 0: they stay those of the command."""


@lru_cache(maxsize=32)
def swing_course(grading: float, entries: int = 256) -> Array:
    """A node's voltage u over the bus voltage at charges q = 0..1 of a swing, and the mean of u since q = 0.

    Shape (2, entries + 1).
    """
    u = np.linspace(0.0, 1.0, 4097)
    power = 1.0 - grading
    charge = 0.5 * (u**power + 1.0 - (1.0 - u) ** power)
    q = np.linspace(0.0, 1.0, entries + 1)
    # Integration by parts: the integral of u over the charge is u q minus that of q over u.
    below = 0.5 * (u + (u ** (1.0 + power) + (1.0 - u) ** (1.0 + power) - 1.0) / (1.0 + power))
    area = np.interp(q, charge, u * charge - below)
    return np.stack([np.interp(q, charge, u), area / np.maximum(q, q[1])])


@lru_cache(maxsize=32)
def swing_lines(grading: float) -> Array:
    """`swing_course` as line segments between its entries, shape (2, entries + 1, 2).

    Each is given by its value extrapolated to entry 0 and its slope; the last one is repeated.
    """
    course = swing_course(grading)
    slopes = np.diff(course, axis=1)
    lines = np.stack([course[:, :-1] - np.arange(slopes.shape[1]) * slopes, slopes], axis=2)
    return np.concatenate([lines, lines[:, -1:]], axis=1)


@njit(cache=True, nogil=True, inline="always")
def _mean_until(charge: float, lines: Array) -> float:
    """Mean of the node's voltage over the bus voltage up to a charge of the swing."""
    place = charge * (lines.shape[1] - 1)
    row = np.uintp(int(place))
    return float(lines[1, row, 0] + lines[1, row, 1] * place)


@njit(cache=True, nogil=True, inline="always")
def _late_by(helping: float, leg: float, swing: Swing) -> float:
    """`_late` for the constant current of the command."""
    x = helping * leg
    if x <= 0.0:
        return leg - swing.takeover * helping
    return 0.5 / helping if x >= 1.0 else leg * (1.0 - _mean_until(x, swing.lines))


@njit(cache=True, nogil=True, inline="always")
def _late(helping: float, pull: Legs, due: tuple[float, float], volts: float, leg: float, swing: Swing) -> float:
    """Delay of an edge's mean over the dead time.

    Parameters
    ----------
    helping : float
        Current over i_k that helps the edge at its command, without the effect of the other legs' edges.
    pull : tuple
        Decrease of it by a volt on each leg's terminal over a carrier's period, this leg's first.
    due : tuple
        Time of the others' edges after the command, as the mean voltage that a pulse gains by it.
    volts : float
        The dead time as such a voltage.
    leg : float
        This leg's dead time over the mean.
    swing : Swing
    """
    now = helping - pull[1] * max(0.0, -due[0]) - pull[2] * max(0.0, -due[1])
    if swing.yielding == 0.0:
        return _late_by(now, leg, swing)
    helping = now + swing.yielding * (helping - now)
    self_pull, first, second = swing.yielding * pull[0], swing.yielding * pull[1], swing.yielding * pull[2]
    if now * leg > QUICK_SWING_KNEES:
        # A linear swing: the change of the current within it is small.
        width = volts / now
        mean = helping - first * _ramp(due[0], width) - second * _ramp(due[1], width)
        return (0.5 + self_pull * width / (24.0 * now)) / max(mean, 0.5 * now)
    wait = volts * leg
    then = helping - first * max(0.0, wait - due[0]) - second * max(0.0, wait - due[1])
    if now + abs(wait) * (abs(first) + abs(second)) <= 0.0:
        return leg - swing.takeover * then
    late, in_time = _swing_late(helping, now, (self_pull, first, second), due, volts, leg, swing.lines)
    return late if in_time else late - swing.takeover * min(0.0, then)


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def _swing_late(
    helping: float, now: float, pull: Legs, due: tuple[float, float], volts: float, leg: float, lines: Array
) -> tuple[float, bool]:
    """`_late` of a slow swing, integrated in steps; and whether it ends within the dead time."""
    if math.isnan(now):
        return now, True
    steps = math.ceil(SWING_STEPS * max(2.0, now * leg))
    step = leg / steps
    # Charge is in entries of the course; `push` and `half_push` are the entries per step and half step.
    places = float(lines.shape[1] - 1)
    push, half_push, own_volts = places * step, 0.5 * places * step, volts * pull[0]
    by_risen, half_by_risen, by_node = push * own_volts, half_push * own_volts, half_push * own_volts * step
    risen, charge, node, since, half_since = 0.0, 0.0, 0.0, volts * step, 0.5 * volts * step
    for m in range(steps):
        begin = since * m
        middle = begin + half_since
        pushed = helping - pull[1] * max(0.0, begin - due[0]) - pull[2] * max(0.0, begin - due[1])
        half = min(max(0.0, charge + half_push * pushed - half_by_risen * risen), places)
        pushed = helping - pull[1] * max(0.0, middle - due[0]) - pull[2] * max(0.0, middle - due[1])
        whole = max(0.0, charge + push * pushed - by_risen * risen - by_node * node)
        if whole >= places:
            part = (places - charge) / (whole - charge)
            return step * m - risen + step * part * (0.5 - 0.5 * node), True
        # Unsigned indices avoid the check for negative ones.
        at_half, at_end = np.uintp(int(half)), np.uintp(int(whole))
        risen += step * (lines[0, at_half, 0] + lines[0, at_half, 1] * half)
        charge, node = whole, lines[0, at_end, 0] + lines[0, at_end, 1] * whole
    return leg - risen, False


@njit(cache=True, nogil=True, inline="always")
def _ramp(start: float, width: float) -> float:
    """Mean of max(0, s - start) over a swing 0..width, each instant weighted by the remaining time."""
    if start >= width:
        return 0.0
    if start <= 0.0:
        return width / 3.0 - start
    remaining = width - start
    return remaining * remaining * remaining / (3.0 * width * width)


@njit(cache=True, nogil=True, inline="always")
def _pulls(inductance: Array, scale: float) -> tuple[Legs, Legs, Legs]:
    """Change of each phase's current by a volt on each leg's terminal, times `scale`; the phase's own leg first."""
    aa, ab, bb = inductance[0], inductance[1], inductance[2]
    half = scale / (3.0 * (aa * bb - ab * ab))
    own_a, across, other = 2.0 * half * bb, half * _SQRT3 * ab, half * 1.5 * aa
    own_b, own_c = 0.25 * own_a + across + other, 0.25 * own_a - across + other
    a_b, c_a, b_c = -0.5 * own_a - across, -0.5 * own_a + across, 0.25 * own_a - other
    return (own_a, a_b, c_a), (own_b, b_c, a_b), (own_c, c_a, b_c)


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def lost_at_edges(
    v_ab: Array,
    i_ab: Array,
    volts: Array,
    starts: Starts,
    legs: Array,
    knees_per_a: float,
    inductance_ab: Array,
    periods_s: Array,
    cycles: Starts,
    swing: Swing,
) -> Array:
    """Voltage (N, 2) lost to dead time in each interval.

    Parameters
    ----------
    v_ab, i_ab : array, shape (N, 2)
    volts : array, shape (N,)
        V_dt in each interval: dead time over the carrier's period, times V_dc.
    starts : array of int64, shape (segments + 1,)
    legs : array, shape (3,)
        Each leg's dead time over their mean.
    knees_per_a : float
        1 / i_k.
    inductance_ab : array, shape (N, 3) or (1, 3)
        L_aa, L_ab, L_bb of the motor in the stator frame, at every interval or at all of them.
    periods_s : array, shape (segments,)
        Carrier period.
    cycles : array of int64, shape (segments,)
        Carrier periods per interval.
    swing : Swing
    """
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        up, down = (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)
        last, share = starts[s + 1] - 1, 1.0 / cycles[s]
        for k in range(starts[s], last + 1):
            after, by = min(k + 1, last), knees_per_a * share
            by_a, by_b, by_c = _pulls(inductance_ab[min(k, inductance_ab.shape[0] - 1)], knees_per_a * periods_s[s])
            a, b, c = phases_of(knees_per_a * i_ab[k, 0], knees_per_a * i_ab[k, 1])
            step_a, step_b, step_c = phases_of(by * (i_ab[after, 0] - i_ab[k, 0]), by * (i_ab[after, 1] - i_ab[k, 1]))
            v_a, v_b, v_c = phases_of(v_ab[k, 0], v_ab[k, 1])
            # Constant over all passes: each current's drift, and the edges without their delays.
            drift_a = step_a - by_a[0] * v_a - by_a[1] * v_b - by_a[2] * v_c
            drift_b = step_b - by_b[0] * v_b - by_b[1] * v_c - by_b[2] * v_a
            drift_c = step_c - by_c[0] * v_c - by_c[1] * v_a - by_c[2] * v_b
            ab, bc, ca = 0.5 * (v_b - v_a), 0.5 * (v_c - v_b), 0.5 * (v_a - v_c)
            lost_a, lost_b, lost_c = 0.0, 0.0, 0.0
            for _ in range(cycles[s]):
                for _ in range(MAX_EDGE_PASSES):
                    (a0, b0, c0), (a1, b1, c1) = up, down
                    a_up, a_down = _edges(
                        a, drift_a, by_a, (ab, -ca), (a0, b0, c0), (a1, b1, c1), volts[k], legs[0], swing
                    )
                    b_up, b_down = _edges(
                        b, drift_b, by_b, (bc, -ab), (b0, c0, a0), (b1, c1, a1), volts[k], legs[1], swing
                    )
                    c_up, c_down = _edges(
                        c, drift_c, by_c, (ca, -bc), (c0, a0, b0), (c1, a1, b1), volts[k], legs[2], swing
                    )
                    up, down = (a_up, b_up, c_up), (a_down, b_down, c_down)
                    moved_up = max(abs(a_up - a0), abs(b_up - b0), abs(c_up - c0))
                    if max(moved_up, abs(a_down - a1), abs(b_down - b1), abs(c_down - c1)) < EDGE_TOLERANCE_RATIO:
                        break
                lost_a += share * (up[0] - down[0])
                lost_b += share * (up[1] - down[1])
                lost_c += share * (up[2] - down[2])
                a, b, c = a + step_a, b + step_b, c + step_c
            alpha, beta = vector_of(lost_a, lost_b, lost_c)
            out[k, 0] = volts[k] * alpha
            out[k, 1] = volts[k] * beta
    return out


@njit(cache=True, nogil=True, inline="always")
def _edges(
    valley: float,
    drift: float,
    pull: Legs,
    leads: tuple[float, float],
    rises: Legs,
    falls: Legs,
    volts: float,
    leg: float,
    swing: Swing,
) -> tuple[float, float]:
    """Delays of a leg's rise and fall in a period over the dead time, from those of all legs in the last pass.

    This leg comes first of three. Times are given as the mean voltage that a pulse gains by them. Without delays,
    `drift` is the change of its current in a period, and `leads` the time by which the others' rises are earlier.
    """
    lost = pull[0] * (rises[0] - falls[0]) + pull[1] * (rises[1] - falls[1]) + pull[2] * (rises[2] - falls[2])
    drift += volts * lost
    rising, falling = valley + 0.25 * drift, valley + 0.75 * drift
    falling += pull[1] * (leads[0] + volts * (rises[0] - rises[1]))
    falling += pull[2] * (leads[1] + volts * (rises[0] - rises[2]))
    up = (volts * rises[1] - leads[0], volts * rises[2] - leads[1])
    down = (volts * falls[1] + leads[0], volts * falls[2] + leads[1])
    rise = _late(-rising, pull, up, volts, leg, swing)
    return rise, _late(falling, pull, down, volts, leg, swing)
