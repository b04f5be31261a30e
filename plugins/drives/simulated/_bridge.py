"""Three legs of a bridge between two turning points of the carrier, compiled: their edges, and what they add up to.

Rising, the carrier turns every leg from low to high, falling from high to low. A leg obeys at once where it need not
wait; else, with the phase current i as it is at the edge (out of the leg positive),

    delay = t_d                        where the current holds the node until the other switch turns on,
            C V / |i|                  where it swings the node itself within t_d: the middle of the ramp,
            t_d - |i| t_d^2 / (4 C V)  where the swing is cut short by the other switch.

Both edges of a period together lose t_d - C V / |i| of the bus against the sign of the current. That is of capacitances
that stay what they are. Those of junctions fall with the voltage v across them as v^-m; both devices' together are then
largest at both rails, and of the charge 2 C V of a whole swing

    x(u) = (u^(1-m) + 1 - (1-u)^(1-m)) / 2

has flown where the node has come the part u of the bus. A whole swing's middle stays where it was, by symmetry; one
that is cut short is late by t_d less the integral of u over its time.

Between edges voltages are constant. Currents within a part are those of the inductance at its start, which is good to
some 0.1 % of the ripple: they decide edges and drops, and are corrected for at its end (`_switching`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from plugins.drives.simulated._energy import Array
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._state import BEHIND_A, BEHIND_B, DUE, LEVEL, SQRT3

NO_EDGE_S = 1e9
"""No edge is pending [s]."""
Three = tuple[float, float, float]


class BridgeParameters(NamedTuple):
    """Devices and carrier, in SI."""

    half_s: float
    """From one turning point of the carrier to the next."""
    dead_s: Three
    two_capacitances_f: float
    """Of both devices of a leg, such that they take the charge of a whole swing."""
    power: float
    """1 - m of the law by which the capacitances fall with their voltage; 1: they do not."""
    switch_v: float
    switch_ohm: float
    diode_v: float
    diode_ohm: float
    knee_a: float
    timer_s: float
    minimum_s: float
    filter_s: float
    """Of the current sensors."""
    core_rate: float
    damper_rate: float


class Part(NamedTuple):
    """A part of the carrier's half, and what stands still during it."""

    start_s: float
    """From the turning point on."""
    stop_s: float
    rising: bool
    duty: Three
    bus_v: float
    warm_v: float
    """Drops over those of cold devices."""
    warm_ohm: float
    i_alpha: float
    """At the start."""
    i_beta: float
    resistance_ohm: float
    alpha_per_h: float
    """The inverse inductance, stator frame."""
    cross_per_h: float
    beta_per_h: float


class Course(NamedTuple):
    """What a part adds up to: integrals over its time."""

    flux_alpha: float
    """Of the legs' voltage [V s]."""
    flux_beta: float
    twice_alpha: float
    """Of that integral [V s^2]."""
    twice_beta: float
    charge: float
    """What the bus gave [A s]."""
    heat_j: float
    """What the devices took."""
    core_alpha: float
    """Of the flux' rate of change, as the branches remember it [V s]."""
    core_beta: float
    damper_alpha: float
    damper_beta: float


@inlined
def edge_time(b: BridgeParameters, rising: bool, duty: float) -> float:
    """When the carrier meets the duty, after its turning point, as the timer can; `half_s` or more: not at all."""
    at = (1.0 - duty if rising else duty) * b.half_s
    return b.timer_s * math.floor(at / b.timer_s + 0.5) if b.timer_s > 0.0 else at


@inlined
def edge_delay(rising: bool, dead_s: float, charge: float, power: float, i: float) -> float:
    """From a command to the step that has the edge's volt-seconds; `charge` is 2 C V, `power` of its law."""
    driving = -i if rising else i
    if driving <= 0.0:
        return dead_s
    if driving * dead_s >= charge:
        return 0.5 * charge / driving
    if power == 1.0:
        return dead_s - 0.5 * driving * dead_s * dead_s / charge
    return dead_s * (1.0 - mean_height(driving * dead_s / charge, power))


@inlined
def mean_height(flown: float, power: float) -> float:
    """Mean part of the bus that a node has come while the part `flown` of a swing's charge flows, evenly in time."""
    low, high = 0.0, 1.0
    for _ in range(40):
        u = 0.5 * (low + high)
        if 0.5 * (u**power + 1.0 - (1.0 - u) ** power) < flown:
            low = u
        else:
            high = u
    # The integral of u over the charge is u x less that of x over u.
    below = 0.5 * (u + (u ** (1.0 + power) + (1.0 - u) ** (1.0 + power) - 1.0) / (1.0 + power))
    return float(u - below / flown)


@inlined
def device_drop(b: BridgeParameters, w: Part, high: bool, i: float) -> float:
    """Voltage that the conducting device of a leg takes from its phase."""
    by_switch = high == (i > 0.0)
    volts = b.switch_v if by_switch else b.diode_v
    ohm = b.switch_ohm if by_switch else b.diode_ohm
    knee = i / math.sqrt(i * i + b.knee_a * b.knee_a)
    return w.warm_v * volts * knee + w.warm_ohm * ohm * i


@inlined
def _next(x: Array, leg: int, rising: bool, commanded_s: float, half_s: float, now_s: float) -> float:
    """When something happens to a leg: an edge comes, is commanded, or is called off before it came."""
    due = float(x[DUE + leg])
    on_its_way = (x[LEVEL + leg] > 0.5) != rising
    if due < NO_EDGE_S:
        return due if on_its_way or commanded_s >= half_s else min(due, max(commanded_s, now_s))
    return max(commanded_s, now_s) if on_its_way and commanded_s < half_s else NO_EDGE_S


@inlined
def _act(b: BridgeParameters, x: Array, leg: int, rising: bool, now_s: float, charge: float, i: float) -> None:
    if x[DUE + leg] >= NO_EDGE_S:
        x[DUE + leg] = now_s + edge_delay(rising, b.dead_s[leg], charge, b.power, i)
        return
    if x[DUE + leg] <= now_s:
        x[LEVEL + leg] = 1.0 - x[LEVEL + leg]
    x[DUE + leg] = NO_EDGE_S


@inlined
def _phases(i_alpha: float, i_beta: float) -> Three:
    return i_alpha, 0.5 * (SQRT3 * i_beta - i_alpha), -0.5 * (SQRT3 * i_beta + i_alpha)


@inlined
def traverse(b: BridgeParameters, w: Part, x: Array) -> Course:
    """Go through a part edge by edge; leaves legs and sensors' filters as they are at its end."""
    at = (edge_time(b, w.rising, w.duty[0]), edge_time(b, w.rising, w.duty[1]), edge_time(b, w.rising, w.duty[2]))
    charge = b.two_capacitances_f * w.bus_v
    now, i_alpha, i_beta = w.start_s, w.i_alpha, w.i_beta
    i = _phases(i_alpha, i_beta)
    flux_alpha = flux_beta = twice_alpha = twice_beta = from_bus = heat = 0.0
    core_alpha = core_beta = damper_alpha = damper_beta = 0.0
    while True:
        leg, then = -1, w.stop_s
        for j in range(3):
            event = _next(x, j, w.rising, at[j], b.half_s, now)
            if event < then:
                leg, then = j, event
        t = then - now
        if t > 0.0:
            drops = (
                device_drop(b, w, x[LEVEL] > 0.5, i[0]),
                device_drop(b, w, x[LEVEL + 1] > 0.5, i[1]),
                device_drop(b, w, x[LEVEL + 2] > 0.5, i[2]),
            )
            v_a, v_b, v_c = (
                x[LEVEL] * w.bus_v - drops[0],
                x[LEVEL + 1] * w.bus_v - drops[1],
                x[LEVEL + 2] * w.bus_v - drops[2],
            )
            v_alpha, v_beta = (2.0 * v_a - v_b - v_c) * (1.0 / 3.0), (v_b - v_c) * (1.0 / SQRT3)
            u_alpha, u_beta = v_alpha - w.resistance_ohm * i_alpha, v_beta - w.resistance_ohm * i_beta
            twice_alpha += t * (flux_alpha + 0.5 * t * v_alpha)
            twice_beta += t * (flux_beta + 0.5 * t * v_beta)
            flux_alpha += t * v_alpha
            flux_beta += t * v_beta
            heat += t * (drops[0] * i[0] + drops[1] * i[1] + drops[2] * i[2])
            slope_alpha = w.alpha_per_h * u_alpha + w.cross_per_h * u_beta
            slope_beta = w.cross_per_h * u_alpha + w.beta_per_h * u_beta
            i_alpha += t * slope_alpha
            i_beta += t * slope_beta
            after = _phases(i_alpha, i_beta)
            for j in range(3):
                from_bus += 0.5 * t * x[LEVEL + j] * (i[j] + after[j])
            i = after
            if b.filter_s > 0.0:
                fade = math.exp(-t / b.filter_s)
                lag = b.filter_s * (1.0 - fade)
                x[BEHIND_A] = fade * x[BEHIND_A] - lag * slope_alpha
                x[BEHIND_B] = fade * x[BEHIND_B] - 0.5 * lag * (SQRT3 * slope_beta - slope_alpha)
            if b.core_rate > 0.0:
                fade = math.exp(-t * b.core_rate)
                core_alpha = fade * core_alpha + (1.0 - fade) / b.core_rate * u_alpha
                core_beta = fade * core_beta + (1.0 - fade) / b.core_rate * u_beta
            if b.damper_rate > 0.0:
                fade = math.exp(-t * b.damper_rate)
                damper_alpha = fade * damper_alpha + (1.0 - fade) / b.damper_rate * u_alpha
                damper_beta = fade * damper_beta + (1.0 - fade) / b.damper_rate * u_beta
        now = then
        if leg < 0:
            break
        _act(b, x, leg, w.rising, now, charge, i[leg])
    if w.stop_s >= b.half_s:
        for j in range(3):
            if x[DUE + j] < NO_EDGE_S:
                x[DUE + j] = max(0.0, x[DUE + j] - b.half_s)
    return Course(
        flux_alpha,
        flux_beta,
        twice_alpha,
        twice_beta,
        from_bus,
        heat,
        core_alpha,
        core_beta,
        damper_alpha,
        damper_beta,
    )
