"""One sample of the plant behind a switched inverter, compiled.

The carrier is gone through in parts, each at most from one turning point to the next and ending where currents are
sampled; shorter ones where R h / L is large, for a part is right to first order in it. `_bridge` says what voltage a
part comes to; `integrate` then takes the plant over it under the mean of that voltage, less what the resistance takes
of the ripple within,

    v_mean = (integral of v) / h - R (mean of i - straight line from its start to its end),

so that every effect of the averaged plant is there as it is. Duties hold the zero sequence that centres the pulses.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from plugins.drives.simulated._bridge import NO_EDGE_S, BridgeParameters, Part, Three, traverse
from plugins.drives.simulated._energy import Array, Energy, hessian
from plugins.drives.simulated._iron import carry_branches, move_branches
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._plant import age, integrate
from plugins.drives.simulated._state import (
    BEHIND_A,
    BEHIND_B,
    BUS,
    CARRIER,
    CORE_D,
    CORE_Q,
    COS,
    DAMPER_D,
    DAMPER_Q,
    DELAYED,
    DUE,
    HEAT,
    I_ALPHA,
    I_BETA,
    JUNCTION,
    LEVEL,
    PSI_D,
    PSI_Q,
    READING_A,
    READING_B,
    SIN,
    SQRT3,
    SUM_A,
    SUM_B,
    SUPPLY,
    VOLTAGES,
    PlantParameters,
)


class SwitchingParameters(NamedTuple):
    """The switched inverter in numbers, in SI."""

    bridge: BridgeParameters
    halves: int
    """Turning points of the carrier in a sample."""
    delay_halves: int
    """Turning points between a row and the first that its voltage acts from."""
    shift_s: float
    """From a turning point to the row that belongs to it."""
    steps: int
    """Of the integration, in a part."""
    parts: int
    """Of half a carrier period."""
    nominal_v: float
    compensated: bool
    logged: bool
    bus_gain: float
    source_ohm: float
    bus_s: float
    """Time constant of source and capacitor; 0: without a capacitor."""
    drop_per_k: float
    ohm_per_k: float
    kelvin_per_watt: float
    junction_step: float
    """1 - exp(-h / tau) in a sample."""
    averaged: bool
    """Whether readings are means since the last row."""


def at_frequency(sw: SwitchingParameters, p: PlantParameters, ratio: float) -> SwitchingParameters:
    """The inverter at so many times its own PWM frequency."""
    halves = round(ratio * sw.halves)
    return sw._replace(
        bridge=sw.bridge._replace(half_s=p.sample_s / halves),
        halves=halves,
        delay_halves=round(ratio * sw.delay_halves),
        steps=math.ceil(p.substeps / (halves * sw.parts)),
    )


@inlined
def _duty(sw: SwitchingParameters, v: float, zero_v: float, bus_v: float) -> float:
    duty = min(1.0, max(0.0, 0.5 + (v + zero_v) / bus_v))
    shortest = 0.5 * sw.bridge.minimum_s / sw.bridge.half_s
    if duty < shortest:
        return 0.0
    return 1.0 if 1.0 - duty < shortest else duty


@inlined
def duties(sw: SwitchingParameters, v_alpha: float, v_beta: float, bus_v: float) -> Three:
    """Duty of each leg for a voltage; the zero sequence puts the extremes at equal distance from both rails."""
    v_a, v_b, v_c = v_alpha, 0.5 * (SQRT3 * v_beta - v_alpha), -0.5 * (SQRT3 * v_beta + v_alpha)
    zero = -0.5 * (max(v_a, v_b, v_c) + min(v_a, v_b, v_c))
    return _duty(sw, v_a, zero, bus_v), _duty(sw, v_b, zero, bus_v), _duty(sw, v_c, zero, bus_v)


@inlined
def _ripple_per_h(p: PlantParameters, e: Energy, spline: Array, x: Array) -> Three:
    """What a volt-second does to the current at once, stator frame: (alpha alpha, alpha beta, beta beta) [1/H]."""
    psi_d = min(max(x[PSI_D], e.low_d), e.high_d)
    psi_q = min(max(x[PSI_Q], -e.high_q), e.high_q)
    dd, dq, qq = hessian(e, spline, psi_d, psi_q)
    dd += p.core_d_per_h + p.damper_d_per_h
    qq += p.core_q_per_h + p.damper_q_per_h
    if p.has_stops:
        dd += 3.0 * p.stop_slope
        qq += 3.0 * p.stop_slope
    c, s = x[COS], x[SIN]
    return (
        c * c * dd - 2.0 * c * s * dq + s * s * qq,
        c * s * (dd - qq) + (c * c - s * s) * dq,
        s * s * dd + 2.0 * c * s * dq + c * c * qq,
    )


@inlined
def _go_through(
    p: PlantParameters,
    e: Energy,
    spline: Array,
    sw: SwitchingParameters,
    x: Array,
    start_s: float,
    stop_s: float,
    rising: bool,
    duty: Three,
) -> float:
    """Bridge and plant over one part; returns what the devices took [J]."""
    h = stop_s - start_s
    from_alpha, from_beta = x[I_ALPHA], x[I_BETA]
    resistance = p.resistance_ohm * (1.0 + x[HEAT])
    alpha_per_h, cross_per_h, beta_per_h = _ripple_per_h(p, e, spline, x)
    part = Part(
        start_s,
        stop_s,
        rising,
        duty,
        x[SUPPLY],
        1.0 + sw.drop_per_k * x[JUNCTION],
        1.0 + sw.ohm_per_k * x[JUNCTION],
        from_alpha,
        from_beta,
        resistance,
        alpha_per_h,
        cross_per_h,
        beta_per_h,
    )
    course = traverse(sw.bridge, part, x)
    # Integral of the flux' departure from a straight line, and of the current's.
    psi_alpha = course.twice_alpha - 0.5 * h * course.flux_alpha
    psi_beta = course.twice_beta - 0.5 * h * course.flux_beta
    ripple_alpha = alpha_per_h * psi_alpha + cross_per_h * psi_beta
    ripple_beta = cross_per_h * psi_alpha + beta_per_h * psi_beta
    v_alpha = (course.flux_alpha - resistance * ripple_alpha) / h
    v_beta = (course.flux_beta - resistance * ripple_beta) / h
    for _ in range(sw.steps):
        integrate(p, e, spline, x, v_alpha, v_beta, h / sw.steps, False)
    c, s = x[COS], x[SIN]
    if sw.bridge.core_rate > 0.0:
        fade = math.exp(-h * sw.bridge.core_rate)
        d, q = c * course.core_alpha + s * course.core_beta, c * course.core_beta - s * course.core_alpha
        carry_branches(x, CORE_D, fade * x[CORE_D] + p.core_d_per_h * d)
        carry_branches(x, CORE_Q, fade * x[CORE_Q] + p.core_q_per_h * q)
    if sw.bridge.damper_rate > 0.0:
        fade = math.exp(-h * sw.bridge.damper_rate)
        d, q = c * course.damper_alpha + s * course.damper_beta, c * course.damper_beta - s * course.damper_alpha
        carry_branches(x, DAMPER_D, fade * x[DAMPER_D] + p.damper_d_per_h * d)
        carry_branches(x, DAMPER_Q, fade * x[DAMPER_Q] + p.damper_q_per_h * q)
    x[SUM_A] += 0.5 * h * (from_alpha + x[I_ALPHA]) + ripple_alpha
    beta = 0.5 * h * (from_beta + x[I_BETA]) + ripple_beta
    x[SUM_B] += 0.5 * (SQRT3 * beta - 0.5 * h * (from_alpha + x[I_ALPHA]) - ripple_alpha)
    _load_bus(p, sw, x, course.charge / h, h)
    return course.heat_j


@inlined
def _load_bus(p: PlantParameters, sw: SwitchingParameters, x: Array, current_a: float, h: float) -> None:
    """The bus after h of a mean current from it."""
    step = -math.expm1(-h / sw.bus_s) if sw.bus_s > 0.0 else 1.0
    x[SUPPLY] += step * (p.dc_bus_v - sw.source_ohm * current_a - x[SUPPLY])


@inlined
def _read_out(sw: SwitchingParameters, x: Array, off: bool, sample_s: float) -> None:
    """What sensors without a fault would read at the row to come."""
    if sw.averaged and not off:
        x[READING_A], x[READING_B] = x[SUM_A] / sample_s, x[SUM_B] / sample_s
    else:
        x[READING_A] = x[I_ALPHA] + x[BEHIND_A]
        x[READING_B] = 0.5 * (SQRT3 * x[I_BETA] - x[I_ALPHA]) + x[BEHIND_B]
    x[SUM_A] = x[SUM_B] = 0.0
    x[BUS] = sw.bus_gain * x[SUPPLY] if sw.logged else sw.nominal_v


@inlined
def advance_switched(
    p: PlantParameters,
    e: Energy,
    spline: Array,
    sw: SwitchingParameters,
    x: Array,
    v_alpha: float,
    v_beta: float,
    off: bool,
) -> None:
    """One sample, from a row to the next."""
    square = x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]
    for j in range(VOLTAGES + 2 * DELAYED - 1, VOLTAGES + 1, -1):
        x[j] = x[j - 2]
    x[VOLTAGES], x[VOLTAGES + 1] = v_alpha, v_beta
    half_s, carrier, heat_j = sw.bridge.half_s, int(x[CARRIER]), 0.0
    if off:
        for j in range(3):
            x[LEVEL + j], x[DUE + j] = 0.0, NO_EDGE_S
        x[BEHIND_A] = x[BEHIND_B] = 0.0
        for _ in range(p.substeps):
            psi_d, psi_q = x[PSI_D], x[PSI_Q]
            integrate(p, e, spline, x, 0.0, 0.0, p.sample_s / p.substeps, True)
            move_branches(p, x, x[PSI_D] - psi_d, x[PSI_Q] - psi_q, p.sample_s / p.substeps)
        for _ in range(sw.halves):
            _load_bus(p, sw, x, 0.0, half_s)
    else:
        for j in range(-1 if sw.shift_s < 0.0 else 0, sw.halves + 1 if sw.shift_s > 0.0 else sw.halves):
            start, stop = 0.0, half_s
            if j < 0:
                start = half_s + sw.shift_s
            elif j == 0 and sw.shift_s > 0.0:
                start = sw.shift_s
            if j == sw.halves:
                stop = sw.shift_s
            elif j == sw.halves - 1 and sw.shift_s < 0.0:
                stop = half_s + sw.shift_s
            # Rows since the one whose voltage the timer holds.
            rows = max(0, -((j - sw.delay_halves) // sw.halves))
            bus_v = sw.bus_gain * x[SUPPLY] if sw.compensated else sw.nominal_v
            duty = duties(sw, x[VOLTAGES + 2 * rows], x[VOLTAGES + 2 * rows + 1], bus_v)
            length = (stop - start) / sw.parts
            for n in range(sw.parts):
                first, last = start + n * length, stop if n == sw.parts - 1 else start + (n + 1) * length
                heat_j += _go_through(p, e, spline, sw, x, first, last, (carrier + j) % 2 == 0, duty)
    x[CARRIER] = (carrier + sw.halves) % 2
    if sw.kelvin_per_watt > 0.0:
        x[JUNCTION] += sw.junction_step * (sw.kelvin_per_watt * heat_j / p.sample_s - x[JUNCTION])
    age(p, x, 0.5 * (square + x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]))
    _read_out(sw, x, off, p.sample_s)
