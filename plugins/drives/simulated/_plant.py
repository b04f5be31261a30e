"""The plant, compiled: inverter, resistance, iron, frame and rotor over one step.

    dpsi/dt = R(-theta) v_ab - R_s i_dq - omega J psi,     i = grad H(psi) + currents of the effects,

psi in the rotor's true frame, the voltage held, Heun's Runge-Kutta scheme of third order. Currents
and voltages are vectors of the stator frame (amplitude-invariant Clarke).
"""

from __future__ import annotations

import math

from plugins.drives.simulated._energy import Array, Energy
from plugins.drives.simulated._iron import Stage, StepConstants, magnetising, move_branches, move_stops
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._state import (
    AMBIENT,
    ANCHOR,
    BUS,
    CORE_D,
    CORE_Q,
    COS,
    DAMPER_D,
    DAMPER_Q,
    DELAYED,
    HEAT,
    HOUSING,
    I_ALPHA,
    I_BETA,
    IRON_D,
    IRON_Q,
    MAGNET_A,
    MOVING,
    MOVING_DRIVEN,
    OMEGA,
    PSI_D,
    PSI_Q,
    READING_A,
    READING_B,
    SIN,
    SKIN_ALPHA,
    SKIN_BETA,
    SQRT3,
    STOPS,
    THETA,
    TORQUE,
    VOLTAGES,
    PlantParameters,
)


@inlined
def _step(x: float) -> float:
    """Smooth odd step from -1 to 1: dead-time voltage over the scaled phase current."""
    if x >= 1.0:
        return 1.0
    if x <= -1.0:
        return -1.0
    return x * (1.5 - 0.5 * x * x)


@inlined
def _impressed(p: PlantParameters, f: StepConstants, y: Stage, i_alpha: float, i_beta: float) -> tuple[float, float]:
    """Voltage that changes the flux: the commanded one less the drops of inverter and copper."""
    if f.off:
        return -(f.resistance_ohm + p.off_ohm) * i_alpha, -(f.resistance_ohm + p.off_ohm) * i_beta
    bus = 1.0 - p.sag_per_watt * 1.5 * (f.v_alpha * i_alpha + f.v_beta * i_beta)
    u_alpha = bus * f.v_alpha - p.bias_alpha_v - f.resistance_ohm * i_alpha
    u_beta = bus * f.v_beta - p.bias_beta_v - f.resistance_ohm * i_beta
    if p.uneven:
        i_a, i_b = i_alpha, -0.5 * i_alpha + 0.5 * SQRT3 * i_beta
        i_c = -i_a - i_b
        lost_a = (p.on_resistance_ohm + p.extra_a_ohm) * i_a
        lost_b = (p.on_resistance_ohm + p.extra_b_ohm) * i_b
        lost_c = p.on_resistance_ohm * i_c
        if p.dead_time_v != 0.0:
            lost_a += p.dead_time_v * _step(i_a * p.dead_time_per_a)
            lost_b += p.dead_time_v * _step(i_b * p.dead_time_per_a)
            lost_c += p.dead_time_v * _step(i_c * p.dead_time_per_a)
        if p.drop_v != 0.0:
            lost_a += p.drop_v * _step(i_a * p.drop_per_a)
            lost_b += p.drop_v * _step(i_b * p.drop_per_a)
            lost_c += p.drop_v * _step(i_c * p.drop_per_a)
        u_alpha -= (2.0 * lost_a - lost_b - lost_c) * (1.0 / 3.0)
        u_beta -= (lost_b - lost_c) * (1.0 / SQRT3)
    if p.skin_ohm != 0.0:
        u_alpha -= p.skin_ohm * (i_alpha - y.skin_alpha)
        u_beta -= p.skin_ohm * (i_beta - y.skin_beta)
    return u_alpha, u_beta


@inlined
def _twist(p: PlantParameters, torque: float) -> float:
    """Electrical angle by which the engaged brake twists [rad]."""
    twist = p.twist_rad_per_nm * torque
    if p.backlash_rad != 0.0:
        twist += 0.5 * p.backlash_rad * math.tanh(torque / p.backlash_nm)
    return twist


@inlined
def _with_eddies(
    p: PlantParameters, f: StepConstants, y: Stage, m_alpha: float, m_beta: float, u_alpha: float, u_beta: float
) -> tuple[float, float]:
    """Solve u = v - e(i_m + u / R_c) by a damped fixed-point iteration, which contracts for any inverter slope."""
    g = p.eddy_siemens
    damping = 1.0 / (1.0 + g * p.inverter_slope_ohm)
    for _ in range(60):
        next_alpha, next_beta = _impressed(p, f, y, m_alpha + g * u_alpha, m_beta + g * u_beta)
        error_alpha, error_beta = damping * (next_alpha - u_alpha), damping * (next_beta - u_beta)
        u_alpha += error_alpha
        u_beta += error_beta
        if error_alpha * error_alpha + error_beta * error_beta < 1e-18 * p.dc_bus_v * p.dc_bus_v:
            break
    return u_alpha, u_beta


@inlined
def _slope(
    p: PlantParameters, f: StepConstants, y: Stage, i_d: float, i_q: float, torque: float
) -> tuple[Stage, float, float]:
    """dy/dt and the stator current (alpha, beta) at a stage whose magnetising current is (i_d, i_q)."""
    c, s, speed, acceleration = f.cos, f.sin, 0.0, 0.0
    if f.moving:
        c, s, speed = math.cos(y.theta), math.sin(y.theta), y.omega
    if f.moving and not f.driven:
        friction = p.viscous * speed / p.pole_pairs + math.copysign(p.friction_nm, speed if speed != 0.0 else torque)
        acceleration = p.pole_pairs * (torque - friction) / p.inertia
    elif p.twists and not f.moving:
        c, s = math.cos(y.theta), math.sin(y.theta)
        behind = f.anchor + _twist(p, torque) - y.theta
        if p.torsion_rate == 0.0:
            speed = behind / p.twist_lag_s
        else:
            speed = y.omega
            acceleration = p.torsion_rate * (p.torsion_rate * behind - 2.0 * p.torsion_damping * speed)
    if f.off:
        # The terminal voltage equals the back-EMF, so that only the iron loss draws a current.
        i_d -= p.eddy_siemens * speed * y.psi_q
        i_q += p.eddy_siemens * speed * y.psi_d
    i_alpha, i_beta = c * i_d - s * i_q, s * i_d + c * i_q
    u_alpha, u_beta = _impressed(p, f, y, i_alpha, i_beta)
    if p.eddy_siemens != 0.0 and not f.off:
        u_alpha, u_beta = _with_eddies(p, f, y, i_alpha, i_beta, u_alpha, u_beta)
        i_alpha += p.eddy_siemens * u_alpha
        i_beta += p.eddy_siemens * u_beta
    turning = 0.0 if f.off else speed
    slope = Stage(
        c * u_alpha + s * u_beta + turning * y.psi_q,
        -s * u_alpha + c * u_beta - turning * y.psi_d,
        speed,
        acceleration,
        p.skin_rate * (i_alpha - y.skin_alpha),
        p.skin_rate * (i_beta - y.skin_beta),
    )
    return slope, i_alpha, i_beta


@inlined
def _add_scaled(y: Stage, h: float, k: Stage) -> Stage:
    """y + h k."""
    return Stage(
        y.psi_d + h * k.psi_d,
        y.psi_q + h * k.psi_q,
        y.theta + h * k.theta,
        y.omega + h * k.omega,
        y.skin_alpha + h * k.skin_alpha,
        y.skin_beta + h * k.skin_beta,
    )


@inlined
def integrate(
    p: PlantParameters, e: Energy, spline: Array, x: Array, v_alpha: float, v_beta: float, h: float, off: bool
) -> None:
    """One Runge-Kutta step of `h` under a constant voltage; the stator current at its end is left in the state."""
    f = StepConstants(
        v_alpha,
        v_beta,
        off,
        p.resistance_ohm * (1.0 + x[HEAT]),
        x[MAGNET_A],
        x[CORE_D] + x[DAMPER_D],
        x[CORE_Q] + x[DAMPER_Q],
        x[MOVING] != 0.0,
        x[MOVING] == MOVING_DRIVEN,
        x[ANCHOR],
        x[COS],
        x[SIN],
        x[PSI_D],
        x[PSI_Q],
        x[STOPS],
        x[STOPS + 1],
        x[STOPS + 2],
        x[STOPS + 3],
        x[STOPS + 4],
        x[STOPS + 5],
    )
    start = Stage(x[PSI_D], x[PSI_Q], x[THETA], x[OMEGA], x[SKIN_ALPHA], x[SKIN_BETA])
    # The first stage's magnetising current is that of the previous step's end.
    i_d, i_q, torque = x[IRON_D], x[IRON_Q], x[TORQUE]
    k1, from_alpha, from_beta = _slope(p, f, start, i_d, i_q, torque)
    y = _add_scaled(start, h / 3.0, k1)
    i_d, i_q, torque = magnetising(p, e, spline, f, y)
    k2, _, _ = _slope(p, f, y, i_d, i_q, torque)
    y = _add_scaled(start, h * (2.0 / 3.0), k2)
    i_d, i_q, torque = magnetising(p, e, spline, f, y)
    k3, _, _ = _slope(p, f, y, i_d, i_q, torque)
    y = _add_scaled(_add_scaled(start, 0.25 * h, k1), 0.75 * h, k3)
    i_d, i_q, torque = magnetising(p, e, spline, f, y)
    x[IRON_D], x[IRON_Q], x[TORQUE] = i_d, i_q, torque
    if p.has_stops:
        move_stops(p, f, x, y.psi_d - f.psi_d, y.psi_q - f.psi_q)
    x[PSI_D], x[PSI_Q] = y.psi_d, y.psi_q
    x[THETA], x[OMEGA] = y.theta, y.omega
    x[SKIN_ALPHA], x[SKIN_BETA] = y.skin_alpha, y.skin_beta
    if f.moving or p.twists:
        x[COS], x[SIN] = math.cos(y.theta), math.sin(y.theta)
    if p.eddy_siemens != 0.0:
        _, x[I_ALPHA], x[I_BETA] = _slope(p, f, y, i_d, i_q, torque)
    else:
        x[I_ALPHA], x[I_BETA] = x[COS] * i_d - x[SIN] * i_q, x[SIN] * i_d + x[COS] * i_q
    _filter_currents(p, x, from_alpha, from_beta, h)
    if p.friction_nm < math.inf and not f.driven:
        _stick_or_slip(p, x, start.omega)


@inlined
def _filter_currents(p: PlantParameters, x: Array, from_alpha: float, from_beta: float, h: float) -> None:
    """First-order lag of the sensors of phases a and b, exact for a current that is linear over the step."""
    a, b = x[I_ALPHA], -0.5 * x[I_ALPHA] + 0.5 * SQRT3 * x[I_BETA]
    if p.filter_s == 0.0:
        x[READING_A], x[READING_B] = a, b
        return
    from_a, from_b = from_alpha, -0.5 * from_alpha + 0.5 * SQRT3 * from_beta
    decay = math.exp(-h / p.filter_s)
    lag_a, lag_b = p.filter_s * (a - from_a) / h, p.filter_s * (b - from_b) / h
    x[READING_A] = a - lag_a + (x[READING_A] - from_a + lag_a) * decay
    x[READING_B] = b - lag_b + (x[READING_B] - from_b + lag_b) * decay


@inlined
def _stick_or_slip(p: PlantParameters, x: Array, omega_before: float) -> None:
    """Coulomb friction: the rotor stops where its speed changes sign and the torque cannot move it."""
    if x[MOVING] == 0.0:
        if abs(x[TORQUE]) > p.friction_nm:
            x[MOVING] = 1.0
            x[OMEGA] = 0.0
    elif omega_before * x[OMEGA] <= 0.0 and abs(x[TORQUE]) <= p.friction_nm:
        x[MOVING] = 0.0
        x[OMEGA] = 0.0
        x[ANCHOR] = x[THETA] - _twist(p, x[TORQUE])


@inlined
def advance_temperatures(p: PlantParameters, x: Array, square_a2: float) -> None:
    """Update winding and magnet temperatures after a sample with this mean squared current."""
    watts = 1.5 * p.resistance_ohm * (1.0 + x[HEAT]) * square_a2
    if p.has_housing:
        winding = x[HEAT] - x[HOUSING] - x[AMBIENT]
        x[HOUSING] += p.housing_step * (p.housing_per_watt * watts - x[HOUSING])
        x[AMBIENT] += p.ambient_step
        x[HEAT] = winding + p.heat_step * (p.heat_per_watt * watts - winding) + x[HOUSING] + x[AMBIENT]
    else:
        x[HEAT] += p.heat_step * (p.heat_per_watt * watts - x[HEAT])
    drift = p.magnet_step * (p.magnet_final_a - x[MAGNET_A])
    x[MAGNET_A] += drift
    x[IRON_D] -= drift


@inlined
def advance(p: PlantParameters, e: Energy, spline: Array, x: Array, v_alpha: float, v_beta: float, off: bool) -> None:
    """Advance the plant by one sample: delayed voltage, electrical states, then temperatures."""
    loss = x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]
    whole_samples = int(p.delay_samples)
    fraction = p.delay_samples - whole_samples
    if p.delay_samples > 0.0:
        for j in range(VOLTAGES + 2 * DELAYED - 1, VOLTAGES + 1, -1):
            x[j] = x[j - 2]
    x[VOLTAGES], x[VOLTAGES + 1] = v_alpha, v_beta
    newest = VOLTAGES + 2 * whole_samples
    n = p.substeps
    for step in range(0 if fraction > 0.0 else n, 2 * n):
        at, share = (newest + 2, fraction) if step < n else (newest, 1.0 - fraction)
        psi_d, psi_q = x[PSI_D], x[PSI_Q]
        integrate(p, e, spline, x, x[at], x[at + 1], share * p.sample_s / n, off)
        if p.has_branches:
            move_branches(p, x, x[PSI_D] - psi_d, x[PSI_Q] - psi_q, share * p.sample_s / n)
    advance_temperatures(p, x, 0.5 * (loss + x[I_ALPHA] * x[I_ALPHA] + x[I_BETA] * x[I_BETA]))
    x[BUS] = p.dc_bus_v * (1.0 - p.sag_per_watt * 1.5 * (v_alpha * x[I_ALPHA] + v_beta * x[I_BETA]))
