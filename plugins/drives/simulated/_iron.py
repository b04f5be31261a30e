"""The iron, compiled: current for a flux, with hysteresis and parallel branches, and the torque.

    i = grad H(psi) - magnets' + slots' + sum of stop operators + core + damper,     T = 3/2 n (psi_d i_q - psi_q i_d)

Core and damper are R-L branches parallel to the magnetising inductance; they are constant during a step
and updated at its end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from plugins.drives.simulated._energy import Array, Energy, current
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._state import (
    CORE_D,
    CORE_Q,
    COS,
    DAMPER_D,
    DAMPER_Q,
    I_ALPHA,
    I_BETA,
    IRON_D,
    IRON_Q,
    READING_A,
    READING_B,
    SIN,
    SQRT3,
    STOPS,
    PlantParameters,
)


class StepConstants(NamedTuple):
    """Quantities that are constant during an integration step."""

    v_alpha: float
    v_beta: float
    off: bool
    resistance_ohm: float
    magnet_a: float
    branch_d: float
    """Current of core and damper branches [A]."""
    branch_q: float
    moving: bool
    driven: bool
    anchor: float
    cos: float
    sin: float
    psi_d: float
    """Flux at the start of the step; the stops likewise."""
    psi_q: float
    stop1_d: float
    stop1_q: float
    stop2_d: float
    stop2_q: float
    stop3_d: float
    stop3_q: float


class Stage(NamedTuple):
    """State at a Runge-Kutta stage."""

    psi_d: float
    psi_q: float
    theta: float
    omega: float
    skin_alpha: float
    skin_beta: float


@inlined
def _stop(p: PlantParameters, limit: float, stop_d: float, stop_q: float, d: float, q: float) -> tuple[float, float]:
    """Vector stop operator after a flux change (d, q): elastic within its limit, an ellipse, and sliding on it."""
    stop_d += p.stop_slope * d
    stop_q += p.stop_slope * q
    along_q = stop_q * p.stop_d_over_q
    square = stop_d * stop_d + along_q * along_q
    if square > limit * limit:
        scale = limit / math.sqrt(square)
        return scale * stop_d, scale * stop_q
    return stop_d, stop_q


@inlined
def magnetising(p: PlantParameters, e: Energy, spline: Array, f: StepConstants, y: Stage) -> tuple[float, float, float]:
    """Magnetising current (i_d, i_q) [A] and torque 3/2 n (psi_d i_q - psi_q i_d) [Nm]."""
    i_d, i_q = current(e, spline, y.psi_d, y.psi_q)
    i_d -= f.magnet_a
    slot_torque = 0.0
    if p.slot_per_h != 0.0:
        angle = p.slot_order * y.theta + p.slot_phase
        c, s = p.slot_per_h * math.cos(angle), p.slot_per_h * math.sin(angle)
        z = y.psi_d - e.psi_m
        i_d += c * z + s * y.psi_q
        i_q += s * z - c * y.psi_q
        slot_torque = -p.slot_order * (0.5 * s * (y.psi_q * y.psi_q - z * z) + c * z * y.psi_q)
    torque = 1.5 * p.pole_pairs * (y.psi_d * i_q - y.psi_q * i_d + slot_torque)
    if p.has_stops:
        d, q = y.psi_d - f.psi_d, y.psi_q - f.psi_q
        limit = p.stop_limit_a
        s1_d, s1_q = _stop(p, limit, f.stop1_d, f.stop1_q, d, q)
        s2_d, s2_q = _stop(p, 2 * limit, f.stop2_d, f.stop2_q, d, q)
        s3_d, s3_q = _stop(p, 3 * limit, f.stop3_d, f.stop3_q, d, q)
        i_d += s1_d + s2_d + s3_d
        i_q += s1_q + s2_q + s3_q
    return i_d + f.branch_d, i_q + f.branch_q, torque


@inlined
def move_stops(p: PlantParameters, f: StepConstants, x: Array, d: float, q: float) -> None:
    """Update the stops after a flux change (d, q)."""
    limit = p.stop_limit_a
    x[STOPS], x[STOPS + 1] = _stop(p, limit, f.stop1_d, f.stop1_q, d, q)
    x[STOPS + 2], x[STOPS + 3] = _stop(p, 2 * limit, f.stop2_d, f.stop2_q, d, q)
    x[STOPS + 4], x[STOPS + 5] = _stop(p, 3 * limit, f.stop3_d, f.stop3_q, d, q)


@inlined
def move_branches(p: PlantParameters, x: Array, d: float, q: float, h: float) -> None:
    """Update core and damper after a flux change (d, q) in h; exact for a constant voltage."""
    if p.core_rate > 0.0:
        fade, share = math.exp(-h * p.core_rate), -math.expm1(-h * p.core_rate) / (h * p.core_rate)
        carry_branches(x, CORE_D, fade * x[CORE_D] + p.core_d_per_h * share * d)
        carry_branches(x, CORE_Q, fade * x[CORE_Q] + p.core_q_per_h * share * q)
    if p.damper_rate > 0.0:
        fade, share = math.exp(-h * p.damper_rate), -math.expm1(-h * p.damper_rate) / (h * p.damper_rate)
        carry_branches(x, DAMPER_D, fade * x[DAMPER_D] + p.damper_d_per_h * share * d)
        carry_branches(x, DAMPER_Q, fade * x[DAMPER_Q] + p.damper_q_per_h * share * q)


@inlined
def carry_branches(x: Array, branch: int, current_a: float) -> None:
    """Set a branch's current [A] and change the stator current by as much."""
    change = current_a - x[branch]
    x[branch] = current_a
    if branch in (CORE_D, DAMPER_D):
        x[IRON_D] += change
        alpha, beta = x[COS] * change, x[SIN] * change
    else:
        x[IRON_Q] += change
        alpha, beta = -x[SIN] * change, x[COS] * change
    x[I_ALPHA] += alpha
    x[I_BETA] += beta
    x[READING_A] += alpha
    x[READING_B] += 0.5 * (SQRT3 * beta - alpha)
