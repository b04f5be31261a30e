"""The blind plant behind a bridge that switches: edges of three legs, swings of the node, drops, bus.

Nothing here is the simulated drive's. A leg's node is a curve in time from its last command on, of which any stretch
has a closed integral: a swing by the phase current is S-shaped, as of a capacitance that is largest at both rails,

    node(t) = x - sin(2 pi x) / (2 pi),    dx/dt = i / Q,    Q the charge of a whole swing,

cut short after the dead time by the other device; where no current helps, the other device turns on after the dead time
and a delay that grows with the current. A swing that takes long goes in short stretches, each by the current of its own
time. Drops follow the logarithm of the current. Between commands the plant goes in Runge-Kutta steps under the mean of
each stretch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from tests.blind.plant import OLD_A, OLD_B, SQRT3, Array, Plant, advance

SAG, DEVICE, EDGES, CARRIER = 22, 23, 24, 33
"""Bus below its open voltage, heat of the devices, (time, direction, charge flown) of three legs' commands, parity."""
SLOW, STRETCHES = 8.0, 12
"""A swing that would take an eighth of the dead time or longer goes in so many stretches of dead time."""


class Bridge(NamedTuple):
    """What switches; `half_s` zero: nothing does."""

    half_s: float = 0.0
    """Half the carrier's period."""
    dead_a_s: float = 0.0
    """Of leg a; the others' next, which is nil only where this is."""
    dead_s: float = 0.0
    charge_c: float = 0.0
    slow_s_per_a: float = 0.0
    """Turning on takes that much longer with the current that is taken over."""
    switch_v: float = 0.0
    """At one ampere."""
    diode_v: float = 0.0
    knee_a: float = 0.01
    switch_ohm: float = 0.0
    diode_ohm: float = 0.0
    heat_k_per_w: float = 0.0
    heat_s: float = 1.0
    v_per_k: float = 0.0
    shortest_s: float = 0.0
    tick_s: float = 0.0
    once: float = 0.0
    """Not zero: one comparison with a whole number of ticks makes both edges; else each counts from its own turn."""
    source_ohm: float = 0.0
    bus_f: float = 1e-3
    bus_gain: float = 1.0
    """Logged over true; zero: the nominal voltage is logged."""
    late_s: float = 0.0
    """Readings after the carrier's valley; negative: before."""
    gain_c: float = 0.0
    """Of a third sensor; zero: there are two."""
    offset_c: float = 0.0


NO_BRIDGE = Bridge()


@njit(cache=True, nogil=True)
def _dead(b: Bridge, leg: int) -> float:
    return b.dead_a_s if leg == 0 else b.dead_s


@njit(cache=True, nogil=True)
def _forced(b: Bridge, dead_s: float, i: float) -> float:
    """When the other device turns on, after the command; i is the current that helps."""
    return dead_s + b.slow_s_per_a * max(0.0, -i)


@njit(cache=True, nogil=True)
def _area(x: float) -> float:
    """Integral of a node's rise over the share of charge that has flown."""
    return 0.5 * x * x + (math.cos(2 * math.pi * x) - 1.0) / (4 * math.pi * math.pi)


@njit(cache=True, nogil=True)
def swung(b: Bridge, dead_s: float, since: float, t: float, i: float, flown: float) -> float:
    """Integral of a node's rise over t [s of full bus], which begins so long after its command; i helps it."""
    free = min(max(_forced(b, dead_s, i) - since, 0.0), t)
    rate = i / b.charge_c if b.charge_c > 0.0 else math.copysign(1e15, i)
    then = min(max(flown + rate * free, 0.0), 1.0)
    if abs(then - flown) < 1e-9:
        return t - free + free * (flown - math.sin(2 * math.pi * flown) / (2 * math.pi))
    swing = (then - flown) / rate
    return t - free + (_area(then) - _area(flown)) / rate + (free - swing) * (1.0 if then == 1.0 else 0.0)


@njit(cache=True, nogil=True)
def _node(b: Bridge, memory: Array, leg: int, now: float, t: float, i: float) -> float:
    """Mean of a node over a stretch, 0 to 1, after its last command; i flows out of the leg."""
    at, up, flown = memory[EDGES + 3 * leg], memory[EDGES + 3 * leg + 1], memory[EDGES + 3 * leg + 2]
    dead_s = _dead(b, leg)
    if up > 0.5:
        return swung(b, dead_s, now - at, t, -i, flown) / t
    return 1.0 - swung(b, dead_s, now - at, t, i, flown) / t


@njit(cache=True, nogil=True)
def _flow(b: Bridge, memory: Array, leg: int, now: float, t: float, i: float) -> None:
    """The charge that a swing has moved after a stretch of this mean current."""
    at, up, flown = memory[EDGES + 3 * leg], memory[EDGES + 3 * leg + 1], memory[EDGES + 3 * leg + 2]
    helping = -i if up > 0.5 else i
    left = _forced(b, _dead(b, leg), helping) - (now - at)
    if left <= t:
        flown = 1.0
    elif b.charge_c > 0.0:
        flown = min(max(flown + helping * t / b.charge_c, 0.0), 1.0)
    elif helping > 0.0:
        flown = 1.0
    memory[EDGES + 3 * leg + 2] = flown


@njit(cache=True, nogil=True)
def _swings_slowly(b: Bridge, memory: Array, leg: int, now: float, i: float) -> bool:
    dead_s = _dead(b, leg)
    waits = memory[EDGES + 3 * leg + 2] < 1.0 and now - memory[EDGES + 3 * leg] < dead_s
    return waits and abs(i) * dead_s < SLOW * b.charge_c


@njit(cache=True, nogil=True)
def _command(b: Bridge, rising: bool, v: float, zero: float, bus_v: float) -> float:
    """When the carrier meets a leg's duty; `half_s`: it does not."""
    duty = min(1.0, max(0.0, 0.5 + (v - zero) / bus_v))
    if duty * 2 * b.half_s < b.shortest_s:
        duty = 0.0
    if (1.0 - duty) * 2 * b.half_s < b.shortest_s:
        duty = 1.0
    at = (1.0 - duty if rising else duty) * b.half_s
    if b.tick_s == 0.0 or at >= b.half_s:
        return at
    if b.once != 0.0 and rising:
        return b.half_s - b.tick_s * math.floor((b.half_s - at) / b.tick_s)
    return b.tick_s * math.floor(at / b.tick_s)


@njit(cache=True, nogil=True)
def _drop(b: Bridge, warm: float, i: float, high: float) -> float:
    """Of a leg that is high for that share of a stretch."""
    size = abs(i)
    rise = math.log(1.0 + size / b.knee_a) / math.log(1.0 + 1.0 / b.knee_a)
    switch, diode = warm * b.switch_v * rise + b.switch_ohm * size, warm * b.diode_v * rise + b.diode_ohm * size
    if i > 0.0:
        return high * switch + (1.0 - high) * diode
    return -high * diode - (1.0 - high) * switch


@njit(cache=True, nogil=True)
def go_through(
    p: Plant, b: Bridge, table: Array, low: float, per_step: float, y: Array, work: Array, v_alpha: float,
    v_beta: float, time: float, believed: float, loose: float, memory: Array,
) -> tuple[float, float]:  # fmt: skip
    """One half of the carrier's period; returns how phase currents a and b change at its end [A/s]."""
    rising = memory[CARRIER] < 0.5
    memory[CARRIER] = 1.0 - memory[CARRIER]
    v_a, v_b, v_c = v_alpha, 0.5 * (SQRT3 * v_beta - v_alpha), 0.5 * (-SQRT3 * v_beta - v_alpha)
    zero = 0.5 * (max(v_a, v_b, v_c) + min(v_a, v_b, v_c))
    for leg in range(3):
        memory[EDGES + 3 * leg] -= b.half_s
    due = (
        _command(b, rising, v_a, zero, p.bus_v),
        _command(b, rising, v_b, zero, p.bus_v),
        _command(b, rising, v_c, zero, p.bus_v),
    )
    now, slope_a, slope_b = 0.0, 0.0, 0.0
    settled = min(b.half_s, max(due) + 2.5 * max(b.dead_s, b.dead_a_s) + 1e-7)
    while now < b.half_s:
        i_a, i_b = memory[OLD_A], memory[OLD_B]
        i = (i_a, i_b, -i_a - i_b)
        then = settled if now < settled else b.half_s
        for leg in range(3):
            if due[leg] < b.half_s and due[leg] <= now and (memory[EDGES + 3 * leg + 1] > 0.5) != rising:
                memory[EDGES + 3 * leg], memory[EDGES + 3 * leg + 2] = due[leg], 0.0
                memory[EDGES + 3 * leg + 1] = 1.0 if rising else 0.0
            if now < due[leg] < then:
                then = due[leg]
            if _swings_slowly(b, memory, leg, now, i[leg]):
                then = min(then, now + b.dead_s / STRETCHES)
        t = then - now
        high = (_node(b, memory, 0, now, t, i_a), _node(b, memory, 1, now, t, i_b), _node(b, memory, 2, now, t, i[2]))
        bus, warm = p.bus_v - memory[SAG], 1.0 + b.v_per_k * memory[DEVICE]
        lost = (_drop(b, warm, i[0], high[0]), _drop(b, warm, i[1], high[1]), _drop(b, warm, i[2], high[2]))
        u_a, u_b, u_c = high[0] * bus - lost[0], high[1] * bus - lost[1], high[2] * bus - lost[2]
        advance(
            p, table, low, per_step, y, work, (2 * u_a - u_b - u_c) / 3, (u_b - u_c) / SQRT3, time + now, t, believed,
            loose, memory,
        )  # fmt: skip
        later = (memory[OLD_A], memory[OLD_B], -memory[OLD_A] - memory[OLD_B])
        for leg in range(3):
            _flow(b, memory, leg, now, t, 0.5 * (i[leg] + later[leg]))
        slope_a, slope_b = (later[0] - i_a) / t, (later[1] - i_b) / t
        drawn = 0.5 * (high[0] * (i[0] + later[0]) + high[1] * (i[1] + later[1]) + high[2] * (i[2] + later[2]))
        if b.source_ohm > 0.0:
            # A small capacitor on a stiff source settles well within a stretch.
            memory[SAG] += (drawn * b.source_ohm - memory[SAG]) * -math.expm1(-t / (b.source_ohm * b.bus_f))
        watts = abs(lost[0] * i[0]) + abs(lost[1] * i[1]) + abs(lost[2] * i[2])
        memory[DEVICE] += t / b.heat_s * (b.heat_k_per_w * watts - memory[DEVICE])
        now = then
    return slope_a, slope_b
