"""Current control in the plane of flux linkage: tables, bandwidth and phase margin over the map's errors.

The controller acts on flux, e = psi(i_ref) - psi(i), so that saturation and cross-saturation are in its tables and one
bandwidth serves every point (H. A. A. Awan et al., doi:10.1109/TIA.2019.2919258). From voltage to flux a machine is an
integrator, and with R_s i and j omega psi fed forward the open loop is

    F(s) = alpha / s * exp(-s T_d) * L (L + dL)^-1,

T_d the delay from sampling to the mean of the voltage. Its phase margin is pi/2 - alpha T_d where the map is right; a
map that is wrong by a factor moves the crossover by that factor (L. Harnefors, H.-P. Nee, doi:10.1109/28.658735).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from protocols import InputError

PHASE_MARGIN_RAD: float = math.radians(60.0)
"""Phase margin over the whole 95 % band; 60 degrees keep the overshoot of a step below 5 %."""
MIN_PHASE_MARGIN_RAD: float = math.radians(30.0)
"""Phase margin below which no controller is written."""
DELAY_SAMPLES: float = 1.5
"""One period for computing, half of one for the mean of the voltage (a zero-order hold)."""
INTEGRAL_RATIO: float = 0.1
"""Bandwidth of the integral part over that of the loop: it costs 6 degrees of phase, and settles what feed-forward
leaves within ten time constants."""
STANDARD_DEVIATIONS: float = 1.96
"""Half a 95 % interval."""
FLUX_NODES = 25
INDUCTANCE_NODES = 13
PLANE_NODES = 41
"""Currents along each axis at which the margin is examined."""


@dataclass(frozen=True)
class CurrentControl:
    """Tables and gains of the current control.

    Attributes
    ----------
    i_d_a, i_q_a : array, shapes (d,), (q,)
        Evenly spaced currents [A].
    psi_wb : array, shape (d, q, 2)
        Flux linkage there [Wb], continued smoothly beyond the measured region.
    gain_i_d_a, gain_i_q_a : array, shapes (m,), (n,)
        Evenly spaced currents of the inductances [A].
    inductance_h : array, shape (m, n, 3)
        Incremental L_dd, L_dq, L_qq [H]; times the bandwidth, the proportional gains of a control of currents [V/A].
    delay_s : float
        From sampling to the mean of the voltage, filters included [s].
    bandwidth_rad_s : float
    integral_rad_s : float
        Bandwidth of the integral part.
    phase_margin_deg, least_phase_margin_deg : float
        With the map as it is, and least over its 95 % band.
    r_s_ohm : float
    """

    i_d_a: Array
    i_q_a: Array
    psi_wb: Array
    gain_i_d_a: Array
    gain_i_q_a: Array
    inductance_h: Array
    delay_s: float
    bandwidth_rad_s: float
    integral_rad_s: float
    phase_margin_deg: float
    least_phase_margin_deg: float
    r_s_ohm: float


def current_control(machine: Machine, limits: DriveLimits, extra_delay_s: float = 0.0) -> CurrentControl:
    """Tables and the largest bandwidth with the phase margin over the map's 95 % band.

    Parameters
    ----------
    machine : Machine
    limits : DriveLimits
    extra_delay_s : float
        Delay of voltage and readings beyond that of sampling and computing [s].

    Raises
    ------
    InputError
        Where an inductance may be zero within its error, so that no bandwidth is safe.
    """
    delay = DELAY_SAMPLES / limits.sampling_hz + extra_delay_s
    factor = _largest_factor(machine, limits)
    alpha = _bandwidth(delay, factor)
    axes = [_even_axis(a, FLUX_NODES, limits) for a in (machine.surface.i_d, machine.surface.i_q)]
    gain_axes = [np.linspace(a[0], a[-1], INDUCTANCE_NODES) for a in axes]
    at = _grid(*gain_axes)
    matrices = machine.inductance(at)
    inductance = np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]], axis=-1)
    return CurrentControl(
        i_d_a=axes[0],
        i_q_a=axes[1],
        psi_wb=machine.psi(_grid(*axes)).reshape(len(axes[0]), len(axes[1]), 2),
        gain_i_d_a=gain_axes[0],
        gain_i_q_a=gain_axes[1],
        inductance_h=inductance.reshape(INDUCTANCE_NODES, INDUCTANCE_NODES, 3),
        delay_s=delay,
        bandwidth_rad_s=alpha,
        integral_rad_s=INTEGRAL_RATIO * alpha,
        phase_margin_deg=math.degrees(phase_margin(alpha, delay)),
        least_phase_margin_deg=math.degrees(phase_margin(alpha, delay, factor)),
        r_s_ohm=machine.r_s_ohm,
    )


def phase_margin(bandwidth_rad_s: float, delay_s: float, factor: float = 1.0) -> float:
    """Phase margin [rad] of alpha k (1 + alpha_i / s) / s exp(-s T_d).

    k = `factor` is the model's inductance over the true one.

    Raises
    ------
    ValueError
        Where a parameter is not positive.
    """
    if min(bandwidth_rad_s, factor) <= 0.0 or delay_s < 0.0:
        raise ValueError("expected a positive bandwidth and factor, and a delay of at least zero")
    gain, corner = factor * bandwidth_rad_s, INTEGRAL_RATIO * bandwidth_rad_s
    # |F| = gain sqrt(w^2 + corner^2) / w^2 = 1.
    crossover = math.sqrt(0.5 * (gain**2 + math.sqrt(gain**4 + 4.0 * (gain * corner) ** 2)))
    return 0.5 * math.pi - math.atan(corner / crossover) - crossover * delay_s


def _bandwidth(delay_s: float, factor: float) -> float:
    """The largest bandwidth [rad/s] with the phase margin at a gain of `factor` and of one."""
    from scipy.optimize import brentq

    def spare(alpha: float) -> float:
        return min(phase_margin(alpha, delay_s, k) for k in (1.0, factor)) - PHASE_MARGIN_RAD

    return float(brentq(spare, 1e-6 / delay_s, 2.0 / delay_s))


def _largest_factor(machine: Machine, limits: DriveLimits) -> float:
    """Largest eigenvalue of L (L + dL)^-1 within the current limit and the 95 % band.

    Raises
    ------
    InputError
        Where L + dL may be singular, or the margin would be lost.
    """
    axis = np.linspace(-limits.current_a, limits.current_a, PLANE_NODES)
    at = _grid(axis, axis)
    at = at[machine.inside(at) & (np.linalg.norm(at, axis=1) <= limits.current_a)]
    inductance, std = machine.inductance(at), machine.inductance_std(at)
    largest = 1.0
    for signs in np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3):
        d, m, q = (STANDARD_DEVIATIONS * signs * std).T
        true = inductance + np.stack([np.stack([d, m], -1), np.stack([m, q], -1)], axis=1)
        least = np.linalg.eigvalsh(true)[:, 0]
        if least.min() <= 0.0:
            i_d, i_q = at[int(np.argmin(least))]
            text = (
                f"an inductance may be zero within its error at i_d {i_d:.3g} A, i_q {i_q:.3g} A; measure more densely"
            )
            raise InputError("flux map", "l_dd_std", text)
        largest = max(largest, float(np.abs(np.linalg.eigvals(inductance @ np.linalg.inv(true))).max()))
    return largest


def _even_axis(nodes: Array, count: int, limits: DriveLimits) -> Array:
    """Evenly spaced currents over the map's axis, symmetric and within twice the current limit."""
    reach = min(float(np.abs(nodes).max()), 2.0 * limits.current_a)
    return np.linspace(max(float(nodes[0]), -reach), min(float(nodes[-1]), reach), count)


def _grid(first: Array, second: Array) -> Array:
    """All pairs of two axes, shape (n m, 2)."""
    return np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
