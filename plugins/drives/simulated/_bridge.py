"""Switching of the three bridge legs within half a carrier period, compiled: edge times and voltage integrals.

A rising carrier switches every leg from low to high, a falling one from high to low. With the phase current i at the
edge (positive out of the leg), the edge comes after its command by

    delay = t_d                        where the diode holds the node until the other switch turns on,
            C V / |i|                  where the current commutates the node within t_d (middle of the ramp),
            t_d - |i| t_d^2 / (4 C V)  where the other switch ends the commutation early.

Both edges of a period together lose t_d - C V / |i| of the bus voltage against the sign of the current. This holds for
constant capacitances. Junction capacitances fall with their voltage v as v^-m. The sum of both devices is then largest
at both rails, and the share

    x(u) = (u^(1-m) + 1 - (1-u)^(1-m)) / 2

of the charge 2 C V of a whole commutation has flown when the node has moved by the share u of the bus voltage. By
symmetry the middle of a whole ramp does not shift; an edge that is ended early is late by t_d - (integral of u dt).

Voltages are constant between edges. Within an interval the current follows from the inductance at its start, which is
exact to some 0.1 % of the ripple. It determines edges and drops; `_switching` corrects it at the interval's end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from plugins.drives.simulated._energy import Array
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._state import DUE, FILTER_LAG_A, FILTER_LAG_B, LEVEL, SQRT3

NO_EDGE_S = 1e9
"""Time of an edge that is not pending [s]."""
Three = tuple[float, float, float]


class BridgeParameters(NamedTuple):
    """Devices and carrier, in SI."""

    half_s: float
    """Half the carrier period: time between two turning points."""
    dead_s: Three
    two_capacitances_f: float
    """2 C: sum over both devices of a leg, averaged over the charge of a whole commutation."""
    charge_exponent: float
    """1 - m with the capacitance proportional to v^-m; 1: constant capacitance."""
    switch_v: float
    switch_ohm: float
    diode_v: float
    diode_ohm: float
    knee_a: float
    timer_s: float
    minimum_s: float
    filter_s: float
    """Time constant of the current sensors."""
    core_rate: float
    damper_rate: float


class Interval(NamedTuple):
    """An interval of half a carrier period, with the quantities that are constant during it."""

    start_s: float
    """Time since the turning point."""
    stop_s: float
    rising: bool
    duty: Three
    bus_v: float
    warm_v: float
    """Forward drop over that of cold devices; `warm_ohm` likewise."""
    warm_ohm: float
    i_alpha: float
    """Current at the interval's start."""
    i_beta: float
    resistance_ohm: float
    alpha_per_h: float
    """Inverse inductance matrix in the stator frame."""
    cross_per_h: float
    beta_per_h: float


class IntervalIntegrals(NamedTuple):
    """Time integrals over an interval."""

    flux_alpha: float
    """Integral of the legs' voltage [V s]."""
    flux_beta: float
    flux_time_alpha: float
    """Integral of `flux_alpha` [V s^2]."""
    flux_time_beta: float
    charge: float
    """Charge drawn from the bus [A s]."""
    heat_j: float
    """Conduction loss of the devices."""
    core_alpha: float
    """Integral of dpsi/dt, weighted by the branch's decay [V s]."""
    core_beta: float
    damper_alpha: float
    damper_beta: float


@inlined
def edge_time(b: BridgeParameters, rising: bool, duty: float) -> float:
    """Time from the turning point to the commanded edge, rounded to the timer; `half_s` or more: no edge."""
    at = (1.0 - duty if rising else duty) * b.half_s
    return b.timer_s * math.floor(at / b.timer_s + 0.5) if b.timer_s > 0.0 else at


@inlined
def edge_delay(rising: bool, dead_s: float, charge: float, charge_exponent: float, i: float) -> float:
    """Delay from the command to the ideal step with the edge's volt-seconds [s]; `charge` is 2 C V [A s]."""
    driving = -i if rising else i
    if driving <= 0.0:
        return dead_s
    if driving * dead_s >= charge:
        return 0.5 * charge / driving
    if charge_exponent == 1.0:
        return dead_s - 0.5 * driving * dead_s * dead_s / charge
    return dead_s * (1.0 - mean_height(driving * dead_s / charge, charge_exponent))


@inlined
def mean_height(flown: float, exponent: float) -> float:
    """Mean of u while the share `flown` of a commutation's charge flows at constant current."""
    low, high = 0.0, 1.0
    for _ in range(40):
        u = 0.5 * (low + high)
        if 0.5 * (u**exponent + 1.0 - (1.0 - u) ** exponent) < flown:
            low = u
        else:
            high = u
    # Integration by parts: integral of u dx = u x - integral of x du.
    below = 0.5 * (u + (u ** (1.0 + exponent) + (1.0 - u) ** (1.0 + exponent) - 1.0) / (1.0 + exponent))
    return float(u - below / flown)


@inlined
def device_drop(b: BridgeParameters, w: Interval, high: bool, i: float) -> float:
    """Forward voltage of the conducting device of a leg [V]."""
    by_switch = high == (i > 0.0)
    volts = b.switch_v if by_switch else b.diode_v
    ohm = b.switch_ohm if by_switch else b.diode_ohm
    knee = i / math.sqrt(i * i + b.knee_a * b.knee_a)
    return w.warm_v * volts * knee + w.warm_ohm * ohm * i


@inlined
def _next_event(x: Array, leg: int, rising: bool, commanded_s: float, half_s: float, now_s: float) -> float:
    """Time of a leg's next event: an edge occurs, is commanded, or is cancelled while pending."""
    due = float(x[DUE + leg])
    is_due = (x[LEVEL + leg] > 0.5) != rising
    if due < NO_EDGE_S:
        return due if is_due or commanded_s >= half_s else min(due, max(commanded_s, now_s))
    return max(commanded_s, now_s) if is_due and commanded_s < half_s else NO_EDGE_S


@inlined
def _apply_event(b: BridgeParameters, x: Array, leg: int, rising: bool, now_s: float, charge: float, i: float) -> None:
    if x[DUE + leg] >= NO_EDGE_S:
        x[DUE + leg] = now_s + edge_delay(rising, b.dead_s[leg], charge, b.charge_exponent, i)
        return
    if x[DUE + leg] <= now_s:
        x[LEVEL + leg] = 1.0 - x[LEVEL + leg]
    x[DUE + leg] = NO_EDGE_S


@inlined
def _phases(i_alpha: float, i_beta: float) -> Three:
    return i_alpha, 0.5 * (SQRT3 * i_beta - i_alpha), -0.5 * (SQRT3 * i_beta + i_alpha)


@inlined
def integrate_interval(b: BridgeParameters, w: Interval, x: Array) -> IntervalIntegrals:
    """Integrate over an interval edge by edge; updates the state of the legs and of the sensors' filters."""
    at = (edge_time(b, w.rising, w.duty[0]), edge_time(b, w.rising, w.duty[1]), edge_time(b, w.rising, w.duty[2]))
    charge = b.two_capacitances_f * w.bus_v
    now, i_alpha, i_beta = w.start_s, w.i_alpha, w.i_beta
    i = _phases(i_alpha, i_beta)
    flux_alpha = flux_beta = flux_time_alpha = flux_time_beta = from_bus = heat = 0.0
    core_alpha = core_beta = damper_alpha = damper_beta = 0.0
    while True:
        leg, then = -1, w.stop_s
        for j in range(3):
            event = _next_event(x, j, w.rising, at[j], b.half_s, now)
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
            flux_time_alpha += t * (flux_alpha + 0.5 * t * v_alpha)
            flux_time_beta += t * (flux_beta + 0.5 * t * v_beta)
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
                x[FILTER_LAG_A] = fade * x[FILTER_LAG_A] - lag * slope_alpha
                x[FILTER_LAG_B] = fade * x[FILTER_LAG_B] - 0.5 * lag * (SQRT3 * slope_beta - slope_alpha)
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
        _apply_event(b, x, leg, w.rising, now, charge, i[leg])
    if w.stop_s >= b.half_s:
        for j in range(3):
            if x[DUE + j] < NO_EDGE_S:
                x[DUE + j] = max(0.0, x[DUE + j] - b.half_s)
    return IntervalIntegrals(
        flux_alpha,
        flux_beta,
        flux_time_alpha,
        flux_time_beta,
        from_bus,
        heat,
        core_alpha,
        core_beta,
        damper_alpha,
        damper_beta,
    )
