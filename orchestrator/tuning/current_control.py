"""Current control in the plane of flux linkage: tables, bandwidth and phase margin over the map's errors.

The controller acts on flux, e = psi(i_ref) - psi(i), so that saturation and cross-saturation are in its tables and one
bandwidth serves every point (H. A. A. Awan et al., doi:10.1109/TIA.2019.2919258). From voltage to flux a machine is an
integrator, and with R_s i and j omega psi fed forward the open loop is

    F(s) = alpha / s * exp(-s T_d) * L (L + dL)^-1,

T_d the delay from sampling to the mean of the voltage. Its phase margin is pi/2 - alpha T_d where the map is right; a
map that is wrong by a factor moves the crossover by that factor (L. Harnefors, H.-P. Nee, doi:10.1109/28.658735).
At a speed j omega psi is fed back through the same delay, which takes from the margin (`phase_margin_at`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from protocols import InputError

PHASE_MARGIN_RAD: float = math.radians(60.0)
"""Phase margin over the whole 95 % band; 60 degrees keep the overshoot of a step below 5 %."""
MIN_PHASE_MARGIN_RAD: float = math.radians(30.0)
"""Phase margin at the largest speed below which there is a remark: a step then overshoots by more than a third."""
DELAY_SAMPLES: float = 1.5
"""One period for computing, half of one for the mean of the voltage (a zero-order hold)."""
INTEGRAL_RATIO: float = 0.1
"""Bandwidth of the integral part over that of the loop: it costs 6 degrees of phase, and settles what feed-forward
leaves within ten time constants."""
STANDARD_DEVIATIONS: float = 1.96
"""Half a 95 % interval."""
FLUX_NODES = 25
INDUCTANCE_NODES = 9
PLANE_NODES = 41
"""Currents along each axis at which the margin is examined."""
CIRCLE_NODES = 180
"""Currents on the circle of the limit, where the iron is most saturated."""
FREQUENCIES = 2000
"""Frequencies of either sign at which the loop's gain is searched for crossings of one, a third of a per cent apart."""


@dataclass(frozen=True)
class LeastInductance:
    """The least inductance that a voltage step on one axis meets within the current limit.

    It is 1 / (L^-1)_kk, which is below L_kk by L_dq^2 / L of the other axis.

    Attributes
    ----------
    inductance_h : float
        [H]
    i_d_a, i_q_a : float
        Current at which it is met, where the iron is most saturated [A].
    at_rest_h : float
        What the step meets without current [H].
    """

    inductance_h: float
    i_d_a: float
    i_q_a: float
    at_rest_h: float


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
        Incremental L_dd, L_dq, L_qq [H].
    least : pair of LeastInductance
        Towards d and q: times the bandwidth, the proportional gains of a PI control of currents [V/A].
    delay_s : float
        From sampling to the mean of the voltage, filters included [s].
    bandwidth_rad_s : float
    integral_rad_s : float
        Bandwidth of the integral part.
    phase_margin_deg, least_phase_margin_deg : float
        At standstill with the map as it is, and least over its 95 % band.
    model_factor : float
        Largest factor of the loop's gain over that band.
    period_s : float
        Of sampling.
    r_s_ohm, winding_c : float
        Resistance of a phase, and the temperature of the winding at which it holds [°C]; None where it is not known.
    """

    i_d_a: Array
    i_q_a: Array
    psi_wb: Array
    gain_i_d_a: Array
    gain_i_q_a: Array
    inductance_h: Array
    least: tuple[LeastInductance, LeastInductance]
    delay_s: float
    bandwidth_rad_s: float
    integral_rad_s: float
    phase_margin_deg: float
    least_phase_margin_deg: float
    model_factor: float
    period_s: float
    r_s_ohm: float
    winding_c: float | None

    def inductance_at(self, i_dq: Array) -> Array:
        """L_dd, L_dq, L_qq [H], shape (n, 3), as the code's table has them at currents (n, 2): linear between nodes."""
        from scipy.interpolate import RegularGridInterpolator

        axes = (self.gain_i_d_a, self.gain_i_q_a)
        held = np.clip(i_dq, [axis[0] for axis in axes], [axis[-1] for axis in axes])
        return np.asarray(RegularGridInterpolator(axes, self.inductance_h)(held))


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
        least=_least_inductances(machine, limits),
        delay_s=delay,
        bandwidth_rad_s=alpha,
        integral_rad_s=INTEGRAL_RATIO * alpha,
        phase_margin_deg=math.degrees(phase_margin(alpha, delay)),
        least_phase_margin_deg=math.degrees(phase_margin(alpha, delay, factor)),
        model_factor=factor,
        period_s=1.0 / limits.sampling_hz,
        r_s_ohm=machine.r_s_ohm,
        winding_c=machine.winding_c,
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


def loop_gains(bandwidth_rad_s: float, integral_rad_s: float, period_s: float) -> tuple[float, float]:
    """Gain K of the flux error and bandwidth B of the observer that is the integral part [rad/s].

    They solve K + B = bandwidth (1 + B period) and K B = bandwidth x integral (1 + B period): the observer learns a
    voltage one period late, which takes the loop's gain by the factor in brackets.

    Raises
    ------
    InputError
        Where the integral part is too fast for the bandwidth, so that no real ones exist.
    """
    linear, product = bandwidth_rad_s * (1.0 - integral_rad_s * period_s), bandwidth_rad_s * integral_rad_s
    square = linear**2 - 4.0 * (1.0 - bandwidth_rad_s * period_s) * product
    if not (square >= 0.0 and linear > 0.0):
        text = f"{integral_rad_s:g} rad/s is too fast for a bandwidth of {bandwidth_rad_s:g} rad/s; at most a quarter"
        raise InputError("current control", "integral_rad_s", text)
    observer = 2.0 * product / (linear + math.sqrt(square))
    return bandwidth_rad_s * (1.0 + observer * period_s) - observer, observer


def open_loop_at(control: CurrentControl, frequency_rad_s: Array, speed_rad_s: float) -> NDArray[np.complex128]:
    """Response of the sampled loop at an electrical speed, for frequencies of either sign in the rotor's frame.

    With w the speed, T the period and the resistance neglected, the machine is psi[k+1] = exp(-j w T) psi[k] +
    T exp(-j w T / 2) v[k-1]. The controller is v = -C psi with its observer's equations put in, of which the C code's
    comments have the terms. A delay beyond 1.5 T is a factor.
    """
    period, turn = control.period_s, 0.5j * speed_rad_s * control.period_s
    gain, observer = loop_gains(control.bandwidth_rad_s, control.integral_rad_s, period)
    z = np.exp(1j * frequency_rad_s * period)
    share, c, g = observer / (1.0 - 1.0 / z), (1.0 - turn) / (1.0 + turn), period / (1.0 + turn)
    scale = 1.0 + g * share / z
    expected_of_psi, expected_of_v = (c + g * share) / scale, g / z / scale
    lost_of_psi, lost_of_v = share * (expected_of_psi / z - 1.0), share * expected_of_v / z
    proportional = gain * (1.0 + 1j * speed_rad_s * (control.delay_s - period))
    controller = (proportional - 1j * speed_rad_s * expected_of_psi - lost_of_psi) / (
        1.0 - 1j * speed_rad_s * expected_of_v - lost_of_v
    )
    further = np.exp(-1j * frequency_rad_s * (control.delay_s - DELAY_SAMPLES * period))
    response: NDArray[np.complex128] = controller * period * np.exp(-turn) / z / (z - np.exp(-2.0 * turn)) * further
    return response


def phase_margin_at(control: CurrentControl, speed_rad_s: float) -> float:
    """Least phase margin at an electrical speed over the map's 95 % band [rad]; of all crossings, of either sign."""
    highest = math.pi / control.period_s
    positive = np.geomspace(1e-3 * highest, 0.999 * highest, FREQUENCIES)
    margins = []
    for frequency in (positive, -positive):
        response = open_loop_at(control, frequency, speed_rad_s)
        for factor in (1.0, control.model_factor):
            above = factor * np.abs(response) > 1.0
            margins.append(np.abs(np.angle(-response[1:]))[above[1:] != above[:-1]])
    return float(np.concatenate(margins).min())


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
    at = _within_limit(machine, limits)
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


def _least_inductances(machine: Machine, limits: DriveLimits) -> tuple[LeastInductance, LeastInductance]:
    """Towards d and q, within the measured part of the current limit and on its circle."""
    turn = np.linspace(0.0, 2.0 * math.pi, CIRCLE_NODES, endpoint=False)
    circle = limits.current_a * np.column_stack([np.cos(turn), np.sin(turn)])
    at = np.concatenate([_within_limit(machine, limits), circle[machine.inside(circle)]])
    met = 1.0 / np.diagonal(np.linalg.inv(machine.inductance(at)), axis1=1, axis2=2)
    at_rest = 1.0 / np.diagonal(np.linalg.inv(machine.inductance(np.zeros((1, 2)))[0]))

    def least(k: int) -> LeastInductance:
        n = int(np.argmin(met[:, k]))
        return LeastInductance(float(met[n, k]), float(at[n, 0]), float(at[n, 1]), float(at_rest[k]))

    return least(0), least(1)


def _within_limit(machine: Machine, limits: DriveLimits) -> Array:
    """Currents over the measured plane within the current limit, shape (n, 2) [A]."""
    axis = np.linspace(-limits.current_a, limits.current_a, PLANE_NODES)
    at = _grid(axis, axis)
    within: Array = at[machine.inside(at) & (np.linalg.norm(at, axis=1) <= limits.current_a * (1.0 + 1e-9))]
    return within


def _even_axis(nodes: Array, count: int, limits: DriveLimits) -> Array:
    """Evenly spaced currents over the map's axis, symmetric and within twice the current limit."""
    reach = min(float(np.abs(nodes).max()), 2.0 * limits.current_a)
    return np.linspace(max(float(nodes[0]), -reach), min(float(nodes[-1]), reach), count)


def _grid(first: Array, second: Array) -> Array:
    """All pairs of two axes, shape (n m, 2)."""
    return np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
