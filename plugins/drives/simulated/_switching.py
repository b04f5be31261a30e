"""One sample of the plant behind a switched inverter, compiled.

A sample is divided into intervals of length h that end at turning points of the carrier and where currents are sampled.
They are shorter where R h / L is large, since an interval is exact to first order in it. `_bridge` integrates the
voltage over an interval; `integrate` then advances the plant under its mean, corrected for the ripple current,

    v_mean = (integral of v) / h - R (mean of i - mean of the straight line from its start to its end),

so that every effect of the averaged plant acts unchanged. Duties include the zero sequence that centres the pulses.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from plugins.drives.simulated._bridge import NO_EDGE_S, BridgeParameters, Interval, Three, integrate_interval
from plugins.drives.simulated._energy import Array, Energy, hessian
from plugins.drives.simulated._iron import carry_branches, move_branches
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._plant import advance_temperatures, integrate
from plugins.drives.simulated._state import (
    BUS,
    CARRIER,
    CORE_D,
    CORE_Q,
    COS,
    DAMPER_D,
    DAMPER_Q,
    DELAYED,
    DUE,
    FILTER_LAG_A,
    FILTER_LAG_B,
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
    half_periods: int
    """Half carrier periods in a sample."""
    delay_half_periods: int
    """Half carrier periods from a row until its voltage acts."""
    shift_s: float
    """Delay of a row's instant after its turning point."""
    steps: int
    """Integration steps in an interval."""
    intervals: int
    """Intervals in half a carrier period."""
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
    """The inverter at `ratio` times its own PWM frequency."""
    half_periods = round(ratio * sw.half_periods)
    return sw._replace(
        bridge=sw.bridge._replace(half_s=p.sample_s / half_periods),
        half_periods=half_periods,
        delay_half_periods=round(ratio * sw.delay_half_periods),
        steps=math.ceil(p.substeps / (half_periods * sw.intervals)),
    )


@inlined
def _duty(sw: SwitchingParameters, v: float, zero_v: float, bus_v: float) -> float:
    duty = min(1.0, max(0.0, 0.5 + (v + zero_v) / bus_v))
    min_duty = 0.5 * sw.bridge.minimum_s / sw.bridge.half_s
    if duty < min_duty:
        return 0.0
    return 1.0 if 1.0 - duty < min_duty else duty


@inlined
def duties(sw: SwitchingParameters, v_alpha: float, v_beta: float, bus_v: float) -> Three:
    """Duty of each leg for a voltage; the zero sequence puts the extremes at equal distance from both rails."""
    v_a, v_b, v_c = v_alpha, 0.5 * (SQRT3 * v_beta - v_alpha), -0.5 * (SQRT3 * v_beta + v_alpha)
    zero = -0.5 * (max(v_a, v_b, v_c) + min(v_a, v_b, v_c))
    return _duty(sw, v_a, zero, bus_v), _duty(sw, v_b, zero, bus_v), _duty(sw, v_c, zero, bus_v)


@inlined
def _ripple_per_h(p: PlantParameters, e: Energy, spline: Array, x: Array) -> Three:
    """Instantaneous inverse inductance in the stator frame: (alpha alpha, alpha beta, beta beta) [1/H]."""
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
def _advance_interval(
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
    """Advance bridge and plant by one interval; returns the devices' loss [J]."""
    h = stop_s - start_s
    from_alpha, from_beta = x[I_ALPHA], x[I_BETA]
    resistance = p.resistance_ohm * (1.0 + x[HEAT])
    alpha_per_h, cross_per_h, beta_per_h = _ripple_per_h(p, e, spline, x)
    interval = Interval(
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
    total = integrate_interval(sw.bridge, interval, x)
    # Integrals of the deviation of flux and of current from a straight line.
    psi_alpha = total.flux_time_alpha - 0.5 * h * total.flux_alpha
    psi_beta = total.flux_time_beta - 0.5 * h * total.flux_beta
    ripple_alpha = alpha_per_h * psi_alpha + cross_per_h * psi_beta
    ripple_beta = cross_per_h * psi_alpha + beta_per_h * psi_beta
    v_alpha = (total.flux_alpha - resistance * ripple_alpha) / h
    v_beta = (total.flux_beta - resistance * ripple_beta) / h
    for _ in range(sw.steps):
        integrate(p, e, spline, x, v_alpha, v_beta, h / sw.steps, False)
    c, s = x[COS], x[SIN]
    if sw.bridge.core_rate > 0.0:
        fade = math.exp(-h * sw.bridge.core_rate)
        d, q = c * total.core_alpha + s * total.core_beta, c * total.core_beta - s * total.core_alpha
        carry_branches(x, CORE_D, fade * x[CORE_D] + p.core_d_per_h * d)
        carry_branches(x, CORE_Q, fade * x[CORE_Q] + p.core_q_per_h * q)
    if sw.bridge.damper_rate > 0.0:
        fade = math.exp(-h * sw.bridge.damper_rate)
        d, q = c * total.damper_alpha + s * total.damper_beta, c * total.damper_beta - s * total.damper_alpha
        carry_branches(x, DAMPER_D, fade * x[DAMPER_D] + p.damper_d_per_h * d)
        carry_branches(x, DAMPER_Q, fade * x[DAMPER_Q] + p.damper_q_per_h * q)
    x[SUM_A] += 0.5 * h * (from_alpha + x[I_ALPHA]) + ripple_alpha
    beta = 0.5 * h * (from_beta + x[I_BETA]) + ripple_beta
    x[SUM_B] += 0.5 * (SQRT3 * beta - 0.5 * h * (from_alpha + x[I_ALPHA]) - ripple_alpha)
    _load_bus(p, sw, x, total.charge / h, h)
    return total.heat_j


@inlined
def _load_bus(p: PlantParameters, sw: SwitchingParameters, x: Array, current_a: float, h: float) -> None:
    """Advance the bus voltage by h at a mean load current."""
    step = -math.expm1(-h / sw.bus_s) if sw.bus_s > 0.0 else 1.0
    x[SUPPLY] += step * (p.dc_bus_v - sw.source_ohm * current_a - x[SUPPLY])


@inlined
def _set_readings(sw: SwitchingParameters, x: Array, off: bool, sample_s: float) -> None:
    """Set the readings of ideal sensors for the next row."""
    if sw.averaged and not off:
        x[READING_A], x[READING_B] = x[SUM_A] / sample_s, x[SUM_B] / sample_s
    else:
        x[READING_A] = x[I_ALPHA] + x[FILTER_LAG_A]
        x[READING_B] = 0.5 * (SQRT3 * x[I_BETA] - x[I_ALPHA]) + x[FILTER_LAG_B]
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
    """Advance the plant by one sample."""
    square = x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]
    for j in range(VOLTAGES + 2 * DELAYED - 1, VOLTAGES + 1, -1):
        x[j] = x[j - 2]
    x[VOLTAGES], x[VOLTAGES + 1] = v_alpha, v_beta
    half_s, carrier, heat_j = sw.bridge.half_s, int(x[CARRIER]), 0.0
    if off:
        for j in range(3):
            x[LEVEL + j], x[DUE + j] = 0.0, NO_EDGE_S
        x[FILTER_LAG_A] = x[FILTER_LAG_B] = 0.0
        for _ in range(p.substeps):
            psi_d, psi_q = x[PSI_D], x[PSI_Q]
            integrate(p, e, spline, x, 0.0, 0.0, p.sample_s / p.substeps, True)
            move_branches(p, x, x[PSI_D] - psi_d, x[PSI_Q] - psi_q, p.sample_s / p.substeps)
        for _ in range(sw.half_periods):
            _load_bus(p, sw, x, 0.0, half_s)
    else:
        for j in range(-1 if sw.shift_s < 0.0 else 0, sw.half_periods + 1 if sw.shift_s > 0.0 else sw.half_periods):
            start, stop = 0.0, half_s
            if j < 0:
                start = half_s + sw.shift_s
            elif j == 0 and sw.shift_s > 0.0:
                start = sw.shift_s
            if j == sw.half_periods:
                stop = sw.shift_s
            elif j == sw.half_periods - 1 and sw.shift_s < 0.0:
                stop = half_s + sw.shift_s
            # Rows since the one whose voltage the timer holds.
            rows = max(0, -((j - sw.delay_half_periods) // sw.half_periods))
            bus_v = sw.bus_gain * x[SUPPLY] if sw.compensated else sw.nominal_v
            duty = duties(sw, x[VOLTAGES + 2 * rows], x[VOLTAGES + 2 * rows + 1], bus_v)
            length = (stop - start) / sw.intervals
            for n in range(sw.intervals):
                first, last = start + n * length, stop if n == sw.intervals - 1 else start + (n + 1) * length
                heat_j += _advance_interval(p, e, spline, sw, x, first, last, (carrier + j) % 2 == 0, duty)
    x[CARRIER] = (carrier + sw.half_periods) % 2
    if sw.kelvin_per_watt > 0.0:
        x[JUNCTION] += sw.junction_step * (sw.kelvin_per_watt * heat_j / p.sample_s - x[JUNCTION])
    advance_temperatures(p, x, 0.5 * (square + x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]))
    _set_readings(sw, x, off, p.sample_s)
