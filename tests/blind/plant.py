"""A motor drive with a locked rotor, written from the equations alone: Runge-Kutta on the currents, two phase sensors.

    psi = grad W'(i_m),   i = i_m + i_eddy + i_hysteresis + i_viscous,   dpsi/dt = R(-theta) (v - e - R i) - w J psi

What it shares with the analysis and the simulated drive is physics, no line of code. Every imperfection has another
form than a textbook's first one: Bouc-Wen hysteresis, eddy currents behind an inductance, two thermal time constants.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

Array = np.ndarray[Any, np.dtype[np.float64]]

SQRT3 = math.sqrt(3.0)

STATES = 21
(MD, MQ, Z, ED, EQ, SKIN, HEAT, TWIST, POWER, CREEP) = (0, 1, 2, 8, 9, 10, 14, 16, 17, 18)
"""Magnetising current, three hysteresis vectors, eddy current, skin lags, two temperatures, ..., viscous current."""
MEMORY = 34
(INT_D, INT_Q, LAG_A, LAG_B, OLD_A, OLD_B, NOISE_A, NOISE_B, SHOWN_A, SHOWN_B, LOOSE, SLOPE_A, SLOPE_B, PAST) = (
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13,
)  # fmt: skip
"""Integrals, lagging and previous phase currents, correlated noise, last codes, contact, slopes, four past voltages.
What follows is the bridge's (`switched`)."""


class Plant(NamedTuple):
    """Everything that a drive and its motor are; zero is absent (see `HEALTHY`)."""

    sample_s: float
    substeps: int
    pole_pairs: float
    resistance: float
    bus_v: float
    # current sensors
    gain_a: float
    gain_b: float
    cubic: float
    offset_a: float
    offset_b: float
    noise: float
    noise_memory: float
    quantum: float
    filter_s: float
    jitter_s: float
    pwm_ripple: float
    drift_a_per_s: float
    gain_drift_per_s: float
    clip_a: float
    hum_a: float
    odd_offset: float
    odd_gain: float
    stick_a: float
    crosstalk: float
    glitch: float
    # voltage
    delay_samples: float
    sag_per_watt: float
    sag_s: float
    bus_ripple: float
    bus_ripple_hz: float
    clock_wander: float
    step_v: float
    """Resolution of the PWM counter."""
    # inverter, per phase
    dead_v: float
    dead_a: float
    dead_shape: int
    dead_trend_per_s: float
    drop_v: float
    drop_a: float
    bias_a: float
    bias_b: float
    # resistance
    extra_a: float
    extra_b: float
    contact_ohm: float
    contact_a: float
    step_ohm: float
    step_at_s: float
    loose_ohm: float
    loose_rate: float
    skin_ohm: float
    skin_slow_hz: float
    skin_fast_hz: float
    heat_fast: float
    heat_fast_s: float
    heat_slow: float
    heat_slow_s: float
    # frame
    angle: float
    twist: float
    twist_s: float
    creep_rad: float
    creep_s: float
    slip_rad: float
    slip_at_s: float
    # iron
    eddy_ohm: float
    eddy_s: float
    eddy_q: float
    """Loss along q over that along d."""
    loop_a: float
    loop_per_wb: float
    loop_power: float
    viscous_per_wb: float
    viscous_s: float
    magnet_a: float
    """The map slides along i_d by this much, in the end."""
    magnet_s: float


HEALTHY = Plant._make(0.0 for _ in Plant._fields)._replace(
    substeps=2, dead_shape=0, glitch=-99.0, gain_a=1.0, gain_b=1.0, dead_a=1.0, drop_a=1.0, sag_s=1e-3, heat_fast_s=1.0,
    heat_slow_s=1.0, contact_a=1.0, skin_slow_hz=30.0, skin_fast_hz=120.0, twist_s=1e-3, creep_s=1.0, eddy_s=1e-5,
    eddy_q=1.0, loop_power=1.0, viscous_s=1.0, magnet_s=1.0, bus_ripple_hz=300.0,
)  # fmt: skip
"""Nothing wrong with it; sizes are absent, time constants are there."""


@njit(cache=True, nogil=True)
def look_up(c: Array, low: float, per_step: float, i_d: float, i_q: float) -> tuple[float, float, float, float, float]:
    """psi_d, psi_q, L_dd, L_dq, L_qq of a table of bicubic B-splines."""
    u, v = (i_d - low) * per_step, (i_q - low) * per_step
    j = min(max(int(u), 1), c.shape[0] - 3)
    k = min(max(int(v), 1), c.shape[1] - 3)
    s, t = u - j, v - k
    r, w = 1.0 - s, 1.0 - t
    a = (r * r * r / 6, (4 - 6 * s * s + 3 * s * s * s) / 6, (4 - 6 * r * r + 3 * r * r * r) / 6, s * s * s / 6)
    a1 = (-r * r / 2, (3 * s * s - 4 * s) / 2, (4 * r - 3 * r * r) / 2, s * s / 2)
    a2 = (r, 3 * s - 2, 3 * r - 2, s)
    b = (w * w * w / 6, (4 - 6 * t * t + 3 * t * t * t) / 6, (4 - 6 * w * w + 3 * w * w * w) / 6, t * t * t / 6)
    b1 = (-w * w / 2, (3 * t * t - 4 * t) / 2, (4 * w - 3 * w * w) / 2, t * t / 2)
    b2 = (w, 3 * t - 2, 3 * w - 2, t)
    f_d = f_q = f_dd = f_dq = f_qq = 0.0
    for m in range(4):
        x0 = x1 = x2 = 0.0
        for n in range(4):
            value = c[j - 1 + m, k - 1 + n]
            x0 += value * b[n]
            x1 += value * b1[n]
            x2 += value * b2[n]
        f_d += a1[m] * x0
        f_q += a[m] * x1
        f_dd += a2[m] * x0
        f_dq += a1[m] * x1
        f_qq += a[m] * x2
    square = per_step * per_step
    return f_d * per_step, f_q * per_step, f_dd * square, f_dq * square, f_qq * square


@njit(cache=True, nogil=True)
def _knee(x: float, shape: int) -> float:
    """An odd step of height one: tanh, straight ramp, algebraic, arctangent."""
    if shape == 0:
        return math.tanh(x)
    if shape == 1:
        return min(1.0, max(-1.0, x))
    if shape == 2:
        return float(x / math.sqrt(1.0 + x * x))
    return float(2.0 / math.pi * math.atan(0.5 * math.pi * x))


@njit(cache=True, nogil=True)
def _phase_loss(p: Plant, dead_v: float, i: float, extra: float, bias: float) -> float:
    loss = extra * i + bias
    if dead_v != 0.0:
        loss += dead_v * _knee(i / p.dead_a, p.dead_shape)
    if p.drop_v != 0.0:
        loss += p.drop_v * _knee(i / p.drop_a, 0)
    return loss


@njit(cache=True, nogil=True)
def _angle(p: Plant, y: Array, time: float, believed: float) -> float:
    theta: float = believed + p.angle + y[TWIST]
    if p.creep_rad != 0.0:
        theta += p.creep_rad * (1.0 - math.exp(-time / p.creep_s))
    if time > p.slip_at_s:
        theta += p.slip_rad
    return theta


@njit(cache=True, nogil=True)
def _stator_current(p: Plant, y: Array, theta: float) -> tuple[float, float, float, float]:
    """The whole current in the true frame and in the stator's."""
    d, q = y[MD], y[MQ]
    if p.loop_a > 0.0:
        d += y[Z] + y[Z + 2] + y[Z + 4]
        q += y[Z + 1] + y[Z + 3] + y[Z + 5]
    if p.eddy_ohm > 0.0:
        d += y[ED]
        q += y[EQ]
    if p.viscous_per_wb > 0.0:
        d += y[CREEP]
        q += y[CREEP + 1]
    c, s = math.cos(theta), math.sin(theta)
    return d, q, c * d - s * q, s * d + c * q


@njit(cache=True, nogil=True)
def _rates(
    p: Plant, table: Array, low: float, per_step: float, y: Array, v_alpha: float, v_beta: float, time: float,
    believed: float, loose: float, out: Array,
) -> None:  # fmt: skip
    """dy/dt into `out`, which starts as zeros: what is absent is not touched."""
    theta = _angle(p, y, time, believed)
    i_d, i_q, i_alpha, i_beta = _stator_current(p, y, theta)
    i_a, i_b = i_alpha, 0.5 * (SQRT3 * i_beta - i_alpha)
    i_c = -i_a - i_b
    slide = p.magnet_a * (1.0 - math.exp(-time / p.magnet_s)) if p.magnet_a != 0.0 else 0.0
    psi_d, psi_q, l_dd, l_dq, l_qq = look_up(table, low, per_step, y[MD] + slide, y[MQ])

    scale = (1.0 - p.sag_per_watt * y[POWER]) * (1.0 + p.clock_wander * time)
    if p.bus_ripple != 0.0:
        scale *= 1.0 + p.bus_ripple * math.sin(2 * math.pi * p.bus_ripple_hz * time)
    u_alpha, u_beta = scale * v_alpha, scale * v_beta
    dead_v = p.dead_v * (1.0 + p.dead_trend_per_s * time)
    extra_a = p.extra_a
    if p.contact_ohm != 0.0:
        extra_a += p.contact_ohm / (1.0 + (i_a / p.contact_a) ** 2)
    e_a = _phase_loss(p, dead_v, i_a, extra_a, p.bias_a)
    e_b = _phase_loss(p, dead_v, i_b, p.extra_b + loose, p.bias_b)
    e_c = _phase_loss(p, dead_v, i_c, 0.0, -p.bias_a - p.bias_b)
    resistance = p.resistance * (1.0 + y[HEAT] + y[HEAT + 1])
    if time > p.step_at_s:
        resistance += p.step_ohm
    u_alpha -= (2 * e_a - e_b - e_c) / 3 + resistance * i_alpha
    u_beta -= (e_b - e_c) / SQRT3 + resistance * i_beta
    if p.skin_ohm != 0.0:
        u_alpha -= p.skin_ohm * (i_alpha - 0.6 * y[SKIN] - 0.4 * y[SKIN + 2])
        u_beta -= p.skin_ohm * (i_beta - 0.6 * y[SKIN + 1] - 0.4 * y[SKIN + 3])
        slow, fast = 2 * math.pi * p.skin_slow_hz, 2 * math.pi * p.skin_fast_hz
        out[SKIN] = slow * (i_alpha - y[SKIN])
        out[SKIN + 1] = slow * (i_beta - y[SKIN + 1])
        out[SKIN + 2] = fast * (i_alpha - y[SKIN + 2])
        out[SKIN + 3] = fast * (i_beta - y[SKIN + 3])

    c, s = math.cos(theta), math.sin(theta)
    rise_d, rise_q = c * u_alpha + s * u_beta, -s * u_alpha + c * u_beta
    if p.twist != 0.0:
        torque = 1.5 * p.pole_pairs * (psi_d * i_q - psi_q * i_d)
        out[TWIST] = (p.twist * torque - y[TWIST]) / p.twist_s
        rise_d += out[TWIST] * psi_q
        rise_q -= out[TWIST] * psi_d
    if p.creep_rad != 0.0:
        turning = p.creep_rad / p.creep_s * math.exp(-time / p.creep_s)
        rise_d += turning * psi_q
        rise_q -= turning * psi_d

    determinant = l_dd * l_qq - l_dq * l_dq
    out[MD] = (l_qq * rise_d - l_dq * rise_q) / determinant
    out[MQ] = (l_dd * rise_q - l_dq * rise_d) / determinant
    if p.magnet_a != 0.0:
        out[MD] -= p.magnet_a / p.magnet_s * math.exp(-time / p.magnet_s)
    if p.loop_a > 0.0:
        for n in range(3):
            _hysteresis(p, y, n, rise_d, rise_q, out)
    if p.eddy_ohm > 0.0:
        out[ED] = (rise_d / p.eddy_ohm - y[ED]) / p.eddy_s
        out[EQ] = (p.eddy_q * rise_q / p.eddy_ohm - y[EQ]) / p.eddy_s
    if p.viscous_per_wb > 0.0:
        # A current that holds against a change of flux and dies away: the iron creeps after.
        out[CREEP] = p.viscous_per_wb * rise_d - y[CREEP] / p.viscous_s
        out[CREEP + 1] = p.viscous_per_wb * rise_q - y[CREEP + 1] / p.viscous_s
    out[HEAT] = out[HEAT + 1] = out[POWER] = 0.0
    if p.heat_fast != 0.0 or p.heat_slow != 0.0:
        loss = 1.5 * resistance * (i_alpha * i_alpha + i_beta * i_beta)
        out[HEAT] = (p.heat_fast * loss - y[HEAT]) / p.heat_fast_s
        out[HEAT + 1] = (p.heat_slow * loss - y[HEAT + 1]) / p.heat_slow_s
    if p.sag_per_watt != 0.0:
        power = 1.5 * (v_alpha * i_alpha + v_beta * i_beta)
        out[POWER] = (power - y[POWER]) / p.sag_s


@njit(cache=True, nogil=True)
def _hysteresis(p: Plant, y: Array, n: int, rise_d: float, rise_q: float, out: Array) -> None:
    """One of three Bouc-Wen vectors (Y.-K. Wen, J. Eng. Mech. Div. 102 (1976) 249): elastic inwards, else soft."""
    d, q = y[Z + 2 * n], y[Z + 2 * n + 1]
    limit = p.loop_a * (n + 1) / 6.0
    slope = p.loop_per_wb / 3.0
    out_d, out_q = slope * rise_d, slope * rise_q
    length = math.sqrt(d * d + q * q)
    if length > 1e-15:
        outwards = (d * rise_d + q * rise_q) / length
        if outwards > 0.0:
            # Beyond its limit, where a step of the integration may have led, it is as at its limit.
            brake = slope * outwards * min(length / limit, 1.0) ** p.loop_power
            out_d -= brake * d / length
            out_q -= brake * q / length
    out[Z + 2 * n], out[Z + 2 * n + 1] = out_d, out_q


@njit(cache=True, nogil=True)
def advance(
    p: Plant, table: Array, low: float, per_step: float, y: Array, work: Array, v_alpha: float, v_beta: float,
    time: float, duration: float, believed: float, loose: float, memory: Array,
) -> None:  # fmt: skip
    """Classical Runge-Kutta over one constant voltage; the sensors' lag goes with it, exact for straight currents."""
    steps = max(1, math.ceil(p.substeps * duration / p.sample_s - 1e-9))
    h = duration / steps
    k1, k2, k3, k4, z = work[0], work[1], work[2], work[3], work[4]
    for n in range(steps):
        t = time + n * h
        _rates(p, table, low, per_step, y, v_alpha, v_beta, t, believed, loose, k1)
        for m in range(STATES):
            z[m] = y[m] + 0.5 * h * k1[m]
        _rates(p, table, low, per_step, z, v_alpha, v_beta, t + 0.5 * h, believed, loose, k2)
        for m in range(STATES):
            z[m] = y[m] + 0.5 * h * k2[m]
        _rates(p, table, low, per_step, z, v_alpha, v_beta, t + 0.5 * h, believed, loose, k3)
        for m in range(STATES):
            z[m] = y[m] + h * k3[m]
        _rates(p, table, low, per_step, z, v_alpha, v_beta, t + h, believed, loose, k4)
        for m in range(STATES):
            y[m] += h / 6 * (k1[m] + 2 * k2[m] + 2 * k3[m] + k4[m])
        _, _, i_alpha, i_beta = _stator_current(p, y, _angle(p, y, t + h, believed))
        i_a, i_b = i_alpha, 0.5 * (SQRT3 * i_beta - i_alpha)
        if p.filter_s > 0.0:
            fade = math.exp(-h / p.filter_s)
            lag_a, lag_b = p.filter_s * (i_a - memory[OLD_A]) / h, p.filter_s * (i_b - memory[OLD_B]) / h
            memory[LAG_A] = i_a - lag_a + (memory[LAG_A] - memory[OLD_A] + lag_a) * fade
            memory[LAG_B] = i_b - lag_b + (memory[LAG_B] - memory[OLD_B] + lag_b) * fade
        else:
            memory[LAG_A], memory[LAG_B] = i_a, i_b
        memory[OLD_A], memory[OLD_B] = i_a, i_b
