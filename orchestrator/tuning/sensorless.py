"""Where a drive without a rotor sensor works: limits of tracking by injection, and of a back-EMF observer.

Injection finds the axis of least incremental inductance. Cross-saturation turns it from the d axis by (`principal`)

    eps(i) = -1/2 atan2(L_dq, (L_qq - L_dd) / 2),

positive in the electrical angle's direction: a tracking that takes this axis for the d axis reads theta + eps, and the
rotor stands at theta = theta_tracked - eps = theta_tracked + 1/2 atan2(2 L_dq, L_qq - L_dd).

A ripple runs through a small loop of the iron's hysteresis, which is flatter than the large-signal curve psi(i): what
a ripple measures is what a tracking sees, and its eps is the one to compensate. The slopes of the large-signal map
give eps', and leave eps - eps'. Hysteresis that is the same in all directions adds a constant to both principal
inverse inductances: it lowers their ratio, but neither turns the axis nor changes 1/l_min - 1/l_max, the signal that
a tracking demodulates. The map's chords psi_q / i_q and (psi_d - psi_d(0)) / i_d have no cross term, and do not show
eps at all. Flux, torque and back-EMF are those of the large-signal map.

The current control holds i* in the estimated frame, so that an error x of the estimate turns the true current,
i = R(x) i*. A tracking loop x' = -k (x - eps(R(x) i*)) then has the gain k (1 - eps_x), with

    eps_x = i_d deps/di_q - i_q deps/di_d,

whether or not eps(i*) is subtracted. It diverges where eps_x > 1; at eps_x = -1 its gain has doubled.

A back-EMF observer integrates v - R_s i to a flux; subtracting L_q i, L_q = psi_q / i_q, leaves the active flux
psi_a = psi_d - L_q i_d along the d axis. A voltage error v_e and an error psi_e of the map's q flux turn it by

    v_e / (omega psi_a)   and   psi_e / psi_a

at most: only the part of the flux error across the d axis turns it, but which part that is depends on how an observer
suppresses drift.

Sources: A. K. Jebai, F. Malrait, P. Martin, P. Rouchon, Int. J. Control 89 (2016), doi:10.1080/00207179.2015.1084049
(injection); I. Boldea, M. C. Paicu, G.-D. Andreescu, IEEE Trans. Power Electron. 23 (2008),
doi:10.1109/TPEL.2008.2004272 (active flux).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis import COPPER_PER_K
from orchestrator.flux_maps import MapSurface, fill_smoothly
from orchestrator.numerics.saliency import Saliency, principal
from orchestrator.numerics.types import Array, Mask
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.machine import Machine
from protocols import FluxMap

MAX_POSITION_ERROR_RAD = math.radians(5.0)
"""Largest error of the position: it costs 0.4 % of the torque at most where i_d = 0."""
INJECTED_RATIO = 0.05
"""Amplitude of the injected current over the largest current: its copper loss is below 0.3 % of the full one."""
CURRENT_NOISE_RATIO = 1e-3
"""Noise of a current reading (rms) over the largest current, where none is given: a 12-bit converter's step is half."""
AVERAGED_READINGS = 16
"""Readings that a tracking averages: four of a ripple's period, and a bandwidth of a quarter of its frequency."""
MAX_ERROR_SLOPE = 1.0
"""Bound of |eps_x|: the loop's gain then stays between nothing and twice its design, within a 6 dB gain margin."""
MAX_AXIS_TURN_RAD = math.pi / 4.0
"""Turn of the axis of least inductance from which the saliency is inverted, and the q axis is tracked instead."""
SIGMAS = 1.96
"""Standard deviations of the error that are kept below the largest error: 95 %."""
UNKNOWN_AXIS_STD_RAD = math.pi / math.sqrt(12.0)
"""Standard deviation of an axis of which nothing is known: uniform over half a turn."""
WARMING_K = 50.0
"""Warming of a winding whose R_s the drive does not follow [K]: half the rise of a class F winding (IEC 60034-1)."""
NEGLIGIBLE_FLUX_RATIO = 1e-9
"""Flux over the largest one that is rounding."""
SMALL_CURRENT_RATIO = 0.02
"""|i_q| over the largest current below which the slope of psi_q stands for its chord psi_q / i_q."""
FUNDAMENTAL_ANGLES = 96
"""Points of a turn at which the fundamental of a leg's voltage error is summed."""


@dataclass(frozen=True)
class Sensorless:
    """Limits over the plane of currents; NaN where the map was not measured.

    Attributes
    ----------
    i_d_a, i_q_a : array, shapes (d,), (q,)
        [A]
    ratio : array, shape (d, q)
        Largest over least incremental inductance.
    injection_error_rad : array, shape (d, q)
        Position error of an uncompensated tracking by injection, by the measured incremental inductances.
    injection_error_std_rad : array, shape (d, q)
        Its standard deviation, to first order in the inductances' errors.
    large_signal_error_rad : array, shape (d, q)
        The same error as predicted by the slopes of the flux map.
    error_slope : array, shape (d, q)
        eps_x, the change of the error with the error of the estimate.
    works : array of bool, shape (d, q)
        Saliency large enough and not inverted, and a loop that converges.
    least_ratio : float
        Ratio of inductances from which the saliency is large enough.
    observer_speed_rad_s : array, shape (d, q)
        Electrical speed from which the observer's error stays within `MAX_POSITION_ERROR_RAD`; infinite where the
        map's error alone exceeds it, or without active flux.
    operating_dq_a : array, shape (n, 2)
        Currents at which the drive works.
    least_speed_rad_s : float
        The largest of the observer's speeds there; NaN where the magnet's flux is not known.
    least_speed_warm_rad_s : float
        The same with R_s off by `WARMING_K` besides.
    operating_error_rad : array, shape (n,)
        `injection_error_rad` there.
    operating_works : array of bool, shape (n,)
        `works` there.
    left_by_map_rad : float
        Largest |error| that a compensation by the drive's table of inductances leaves to injection there, as far as
        the saliency is large enough and not inverted; NaN where it nowhere is.
    """

    i_d_a: Array
    i_q_a: Array
    ratio: Array
    injection_error_rad: Array
    injection_error_std_rad: Array
    large_signal_error_rad: Array
    error_slope: Array
    works: Mask
    least_ratio: float
    observer_speed_rad_s: Array
    operating_dq_a: Array
    least_speed_rad_s: float
    least_speed_warm_rad_s: float
    operating_error_rad: Array
    operating_works: Mask
    left_by_map_rad: float


def sensorless_limits(
    machine: Machine,
    compensation: Compensation,
    current_a: float,
    operating_dq: Array,
    *,
    injection: FluxMap | None = None,
    current_noise_a: float | None = None,
    table: Callable[[Array], Array] | None = None,
) -> Sensorless:
    """Limits of both methods.

    Parameters
    ----------
    machine : Machine
    compensation : Compensation
        Its uncertainty is the error that a compensated inverter keeps.
    current_a : float
        Largest |i| of the drive [A peak].
    operating_dq : array, shape (n, 2)
        Currents at which the drive works, such as those of maximum torque per ampere [A].
    injection : FluxMap, optional
        Map with inductances measured by a ripple; by default the machine's own map. Its tables serve where it was
        measured, the machine's elsewhere.
    current_noise_a : float, optional
        Noise of a current reading, rms [A].
    table : callable, optional
        L_dd, L_dq, L_qq (n, 3) [H] over currents (n, 2) that the drive compensates with; by default the map's slopes.
    """
    from scipy.interpolate import RegularGridInterpolator

    i_d, i_q = machine.surface.i_d, machine.surface.i_q
    nodes = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    shape = (len(i_d), len(i_q))
    inside = machine.inside(nodes)
    measured, std = _incremental(machine, injection, nodes)
    seen, by_map = principal(*measured.T), principal(*_slopes(machine, nodes).T)
    slope = _error_slope(i_d, i_q, measured.reshape(*shape, 3))
    at_operating = principal(*_incremental(machine, injection, operating_dq)[0].T)
    operating_slope = RegularGridInterpolator((i_d, i_q), slope, bounds_error=False, fill_value=None)(operating_dq)
    noise_a = CURRENT_NOISE_RATIO * current_a if current_noise_a is None else current_noise_a
    least_ratio = _least_ratio(noise_a / (INJECTED_RATIO * current_a))
    speed, at_work, warm = (
        _observer_speed(machine, compensation, i_dq, current_a, r_s_error)
        for i_dq, r_s_error in ((nodes, 0.0), (operating_dq, 0.0), (operating_dq, COPPER_PER_K * WARMING_K))
    )

    def measured_only(values: Array) -> Array:
        return np.where(inside, values, np.nan).reshape(shape)

    return Sensorless(
        i_d_a=i_d,
        i_q_a=i_q,
        ratio=measured_only(seen.ratio),
        injection_error_rad=measured_only(seen.angle_rad),
        injection_error_std_rad=measured_only(_angle_std(measured, std)),
        large_signal_error_rad=measured_only(by_map.angle_rad),
        error_slope=measured_only(slope.ravel()),
        works=(inside & _is_salient(seen, least_ratio)).reshape(shape) & (np.abs(slope) < MAX_ERROR_SLOPE),
        least_ratio=least_ratio,
        observer_speed_rad_s=measured_only(speed),
        operating_dq_a=operating_dq,
        least_speed_rad_s=float(np.max(at_work)),
        least_speed_warm_rad_s=float(np.max(warm)),
        operating_error_rad=at_operating.angle_rad,
        operating_works=_is_salient(at_operating, least_ratio) & (np.abs(operating_slope) < MAX_ERROR_SLOPE),
        left_by_map_rad=_left_by(
            principal(*(_slopes(machine, operating_dq) if table is None else table(operating_dq)).T),
            at_operating,
            least_ratio,
        ),
    )


def _least_ratio(noise_ratio: float) -> float:
    """Ratio of inductances at which noise of a reading, over the injected current, leaves the largest position error.

    A flux ripple at an angle x to the axis of least inductance, along which it gives the current I, gives across it
    I (1 - 1/ratio) sin(2 x) / 2; its amplitude is known to sqrt(2 / n) times the noise of n readings.
    """
    noise = SIGMAS * math.sqrt(2.0 / AVERAGED_READINGS) * noise_ratio
    contrast = noise / (0.5 * math.sin(2.0 * MAX_POSITION_ERROR_RAD))
    return 1.0 / (1.0 - contrast) if contrast < 1.0 else math.inf


def _slopes(machine: Machine, i_dq: Array) -> Array:
    """L_dd, L_dq, L_qq as slopes of the flux map, shape (n, 3) [H]."""
    slopes = machine.inductance(i_dq)
    return np.column_stack([slopes[:, 0, 0], slopes[:, 0, 1], slopes[:, 1, 1]])


def _incremental(machine: Machine, injection: FluxMap | None, i_dq: Array) -> tuple[Array, Array]:
    """L_dd, L_dq, L_qq as measured and their standard deviations, shapes (n, 3) [H]: by injection where there is one,
    else by the map's tables, else the map's slopes."""
    found, std = _slopes(machine, i_dq), machine.inductance_std(i_dq)
    for one in (machine.flux_map, injection):
        if one is None:
            continue
        known = MapSurface(one).inside(i_dq)
        for k, name in enumerate(("l_dd", "l_dq", "l_qq")):
            for target, table in ((found, name), (std, f"{name}_std")):
                values = _at(one, table, i_dq)
                if values is not None:
                    target[known, k] = values[known]
    return found, std


def _at(flux_map: FluxMap, name: str, i_dq: Array) -> Array | None:
    """A table of a map at currents, shape (n,), linear between its nodes and held beyond; None where it is empty."""
    from scipy.interpolate import RegularGridInterpolator

    i_d, i_q = (np.asarray(axis, dtype=np.float64) for axis in (flux_map.i_d, flux_map.i_q))
    table = np.asarray(getattr(flux_map, name), dtype=np.float64)
    if np.isfinite(table).sum() < 3:  # points that span an area
        return None
    held = np.clip(i_dq, [i_d[0], i_q[0]], [i_d[-1], i_q[-1]])
    return np.asarray(RegularGridInterpolator((i_d, i_q), fill_smoothly(i_d, i_q, table, name))(held))


def _is_salient(seen: Saliency, least_ratio: float) -> Mask:
    """Whether the saliency is large enough and not inverted."""
    salient: Mask = (seen.ratio >= least_ratio) & (np.abs(seen.angle_rad) < MAX_AXIS_TURN_RAD)
    return salient


def _left_by(known: Saliency, seen: Saliency, least_ratio: float) -> float:
    """Largest error of the position that a compensation by known inductances leaves to injection."""
    # An axis has no direction: angles are the same modulo half a turn.
    left = 0.5 * np.abs(np.angle(np.exp(2j * (seen.angle_rad - known.angle_rad))))[_is_salient(seen, least_ratio)]
    return float(left.max()) if len(left) else math.nan


def _error_slope(i_d: Array, i_q: Array, inductance: Array) -> Array:
    """eps_x over a grid of L_dd, L_dq, L_qq, shape (d, q, 3); 0 where there is no saliency."""
    cross, half = inductance[..., 1], 0.5 * (inductance[..., 2] - inductance[..., 0])
    turning = np.zeros_like(cross)
    for axis, weight in ((0, -i_q[None, :]), (1, i_d[:, None])):
        along = (i_d, i_q)[axis]
        d_cross, d_half = (np.gradient(table, along, axis=axis) for table in (cross, half))
        turning += weight * (half * d_cross - cross * d_half)
    size = half**2 + cross**2
    return np.divide(-0.5 * turning, size, out=np.zeros_like(size), where=size > 0.0)


def _angle_std(inductance: Array, std: Array) -> Array:
    """Standard deviation of the axis' angle for L_dd, L_dq, L_qq and their standard deviations, shapes (n, 3)."""
    cross, half = inductance[:, 1], 0.5 * (inductance[:, 2] - inductance[:, 0])
    half_std = 0.5 * np.hypot(std[:, 0], std[:, 2])
    size = half**2 + cross**2
    spread = np.hypot(half * std[:, 1], cross * half_std)
    angle: Array = np.divide(0.5 * spread, size, out=np.full_like(size, np.inf), where=size > 0.0)
    return np.minimum(angle, UNKNOWN_AXIS_STD_RAD)


def _observer_speed(
    machine: Machine, compensation: Compensation, i_dq: Array, current_a: float, r_s_error: float
) -> Array:
    """Speed from which the observer's error stays within its limit, shape (n,) [rad/s], for R_s off by a relative
    error and its standard deviation; NaN where the magnet's flux is not known."""
    at_rest = float(machine.psi(np.zeros((1, 2)))[0, 0])
    negligible = NEGLIGIBLE_FLUX_RATIO * float(np.abs(machine.surface.fluxes).max())
    if machine.motor.pm_flux_wb is None and abs(at_rest) <= negligible:
        return np.full(len(i_dq), np.nan)
    psi, size = machine.psi(i_dq), np.linalg.norm(i_dq, axis=1)
    small = np.abs(i_dq[:, 1]) < SMALL_CURRENT_RATIO * current_a
    l_q = np.where(small, _slopes(machine, i_dq)[:, 2], psi[:, 1] / np.where(small, 1.0, i_dq[:, 1]))
    active = psi[:, 0] - l_q * i_dq[:, 0]
    random_v = np.hypot(machine.r_s_std_ohm * size, np.hypot(_leg_error_v(compensation, size), compensation.bias_std_v))
    volts = SIGMAS * random_v + r_s_error * machine.r_s_ohm * size
    active = np.where(np.abs(active) > negligible, active, 0.0)
    room = (MAX_POSITION_ERROR_RAD * active) ** 2 - (SIGMAS * machine.psi_std(i_dq)[:, 1]) ** 2
    speed: Array = np.full_like(room, np.inf)
    np.divide(volts, np.sqrt(np.maximum(room, 0.0)), out=speed, where=room > 0.0)
    return speed


def _leg_error_v(compensation: Compensation, size_a: Array) -> Array:
    """Fundamental of the voltage error left by the legs at currents of these lengths, shape (n,) [V].

    The error is odd in the leg's current, and of one sign for all of them: 2 / n times the sum of e(|i| cos x) cos x.
    """
    wave = np.abs(np.cos(2.0 * math.pi * (np.arange(FUNDAMENTAL_ANGLES) + 0.5) / FUNDAMENTAL_ANGLES))
    error = np.interp(size_a[:, None] * wave, compensation.current_a, compensation.lost_std_v)
    return np.asarray(2.0 * np.mean(error * wave, axis=1))
