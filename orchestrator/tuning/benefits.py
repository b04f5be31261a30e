"""What a tuning changes: torque by the map beside constant inductances, phase current beside one without compensation.

The current is that of an averaged model, one step a PWM period, of the machine's tables behind the inverter's loss and
under the flux control of the C code without its limits. Neither PWM, noise nor an error of the map is in it.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.current_control import STANDARD_DEVIATIONS, CurrentControl, loop_gains
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import CurrentReferences

SPEED_RATIO = 0.02
"""Speed of the current's wave over the rated speed, so that it is the same at other limits; else over the largest."""
TORQUE_RATIO = 0.25
"""Torque of the wave over the largest one: small currents suffer most from dead time."""
MAX_STEPS = 4000
"""PWM periods of two sixths of a turn; the wave of a slower one is drawn at the speed that takes so many."""
SETTLING_TIME_CONSTANTS = 10.0
"""Time constants of the integral part that pass before the sixth that is drawn."""
SIXTH = math.pi / 3.0
"""After it the phases have changed places, and everything repeats in the rotor's frame."""
WAVE_POINTS = 360
TORQUE_POINTS = 41
NEWTON_STEPS = 3


@dataclass(frozen=True)
class Benefits:
    """Waves and torques, with the tuning and without it.

    Attributes
    ----------
    wanted_nm, by_map_nm, by_constants_nm : array, shape (n,)
        Torque commands up to the largest, and what the references of the map and those of constant inductances give.
    angle_rad : array, shape (k,)
        A turn.
    wave_a, wave_without_a : array, shape (k,)
        Phase current with the compensation at the 95 % edge of its error, and without any.
    speed_rad_s : float
        Electrical speed of the waves.
    """

    wanted_nm: Array
    by_map_nm: Array
    by_constants_nm: Array
    angle_rad: Array
    wave_a: Array
    wave_without_a: Array
    speed_rad_s: float

    @property
    def torque_error_percent(self) -> float:
        """rms of the torque error of constant inductances over the largest torque."""
        return 100.0 * float(np.sqrt(np.mean((self.by_constants_nm - self.wanted_nm) ** 2))) / float(self.wanted_nm[-1])

    @property
    def harmonics_percent(self) -> float:
        """5th and 7th harmonic over the fundamental, compensated."""
        return _harmonics_percent(self.wave_a)

    @property
    def harmonics_without_percent(self) -> float:
        """The same without compensation."""
        return _harmonics_percent(self.wave_without_a)


def benefits_of(
    machine: Machine,
    limits: DriveLimits,
    references: CurrentReferences,
    control: CurrentControl,
    compensation: Compensation,
) -> Benefits:
    """Benefits of a tuning."""
    wanted = np.linspace(0.0, float(references.torque_limit_nm[-1]), TORQUE_POINTS)
    unlimited = np.full(TORQUE_POINTS, references.psi_limit_wb[-1])
    i_dq = references.at(wanted, unlimited)
    i_constants = _currents_by_constants(machine, limits.current_a, wanted)
    fastest = 2.0 * SIXTH / (MAX_STEPS * control.period_s)
    speed = max(SPEED_RATIO * _reference_speed(machine, limits), fastest)
    small = complex(*references.at(wanted[-1:] * TORQUE_RATIO, unlimited[:1])[0])
    angle = 2.0 * math.pi * np.arange(WAVE_POINTS) / WAVE_POINTS
    lost = compensation.lost_v + limits.bus_v * compensation.lost_per_bus_v
    true = lost + STANDARD_DEVIATIONS * compensation.lost_std_v * np.sign(compensation.current_a)
    with_compensation, without = (
        _wave(control, compensation.current_a, true, added, small, speed, angle)
        for added in (lost, np.zeros_like(lost))
    )
    by_map, by_constants = machine.torque_nm(i_dq), machine.torque_nm(i_constants)
    return Benefits(wanted, by_map, by_constants, angle, with_compensation, without, speed)


def _reference_speed(machine: Machine, limits: DriveLimits) -> float:
    """The rated electrical speed [rad/s], or the largest one where it is unknown or smaller."""
    rated = machine.motor.rated_speed_rpm
    return min(limits.speed_rad_s, math.inf if rated is None else rated * machine.pole_pairs * math.pi / 30.0)


def _currents_by_constants(machine: Machine, current_a: float, torque_nm: Array) -> Array:
    """Least currents for torques [A], shape (n, 2), of constant inductances: the nameplate's, else the map's at rest.

    At |i| = r it is i_d = (psi - sqrt(psi^2 + 8 dL^2 r^2)) / (4 dL) with dL = L_q - L_d.
    """
    motor, rest = machine.motor, np.zeros((1, 2))
    slopes = machine.inductance(rest)[0]
    l_d, l_q = motor.d_inductance_h or float(slopes[0, 0]), motor.q_inductance_h or float(slopes[1, 1])
    psi = float(machine.psi(rest)[0, 0]) if motor.pm_flux_wb is None else motor.pm_flux_wb
    r, difference = np.linspace(0.0, current_a, 401), l_q - l_d
    root = np.sqrt(psi**2 + 8.0 * difference**2 * r**2)
    # The same quotient without a difference of equal numbers.
    i_d = -2.0 * difference * r**2 / np.maximum(psi + root, 1e-12)
    i_q = np.sqrt(np.maximum(r**2 - i_d**2, 0.0))
    torque = 1.5 * machine.pole_pairs * (psi - difference * i_d) * i_q
    return np.column_stack([np.interp(torque_nm, torque, i_d), np.interp(torque_nm, torque, i_q)])


def _wave(
    control: CurrentControl,
    current_a: Array,
    lost_v: Array,
    added_v: Array,
    i_ref: complex,
    speed: float,
    angle: Array,
) -> Array:
    """Current of phase a over a turn, for a loss of the legs and what is added to them over their currents."""
    period, table = control.period_s, _FluxTable(control)
    gain, observer = loop_gains(control.bandwidth_rad_s, control.integral_rad_s, period)
    half_turn = 0.5j * speed * period
    count = max(round(SIXTH / (speed * period)), 2)
    i, psi_ref = i_ref, table.flux(i_ref)[0]
    psi = psi_ref
    observed, given, expected = 0j, control.r_s_ohm * i + 1j * speed * psi, psi
    found = np.empty(count, dtype=complex)
    before = math.ceil(SETTLING_TIME_CONSTANTS / (control.integral_rad_s * period * count))
    for n in range((before + 1) * count):
        turn = cmath.exp(1j * speed * period * n)
        i = table.current(psi, i)
        found[n % count] = i
        observed += observer * (expected - psi)
        expected = ((1.0 - half_turn) * psi + period * (given - control.r_s_ohm * i - observed)) / (1.0 + half_turn)
        error = psi_ref - psi
        v = control.r_s_ohm * i + 1j * speed * expected + observed
        v += gain * (1.0 + 1j * speed * (control.delay_s - period)) * error
        missing = _of_legs(current_a, added_v, i_ref * turn) - _of_legs(current_a, lost_v, i * turn)
        acting = given + missing / turn - control.r_s_ohm * i
        psi = ((1.0 - half_turn) * psi + period * acting) / (1.0 + half_turn)
        given = v
    at = (angle % SIXTH) / SIXTH * count
    periodic = np.append(found, found[0])
    wave: Array = (np.interp(at, np.arange(count + 1), periodic) * np.exp(1j * angle)).real
    return wave


def _of_legs(current_a: Array, volts: Array, i_ab: complex) -> complex:
    """Vector of a voltage of each leg over its current."""
    directions = [cmath.exp(2j * math.pi * k / 3.0) for k in range(3)]
    legs = np.interp([(i_ab * d.conjugate()).real for d in directions], current_a, volts)
    return complex(2.0 / 3.0 * np.dot(legs, directions))


class _FluxTable:
    """The table of the C code and its inverse, in complex numbers."""

    def __init__(self, control: CurrentControl) -> None:
        self._psi = (control.psi_wb[..., 0] + 1j * control.psi_wb[..., 1]).tolist()
        self._first = complex(control.i_d_a[0], control.i_q_a[0])
        self._steps = control.i_d_a[1] - control.i_d_a[0], control.i_q_a[1] - control.i_q_a[0]
        self._last = len(control.i_d_a) - 2, len(control.i_q_a) - 2

    def flux(self, i: complex) -> tuple[complex, complex, complex]:
        """Flux linkage [Wb] and its slopes along d and q [H]."""
        x, y = (i.real - self._first.real) / self._steps[0], (i.imag - self._first.imag) / self._steps[1]
        j, k = min(max(int(x), 0), self._last[0]), min(max(int(y), 0), self._last[1])
        u, v = x - j, y - k
        near, far = self._psi[j], self._psi[j + 1]
        along_d = (1.0 - v) * (far[k] - near[k]) + v * (far[k + 1] - near[k + 1])
        along_q = (1.0 - u) * (near[k + 1] - near[k]) + u * (far[k + 1] - far[k])
        start = near[k] + v * (near[k + 1] - near[k])
        return start + u * along_d, along_d / self._steps[0], along_q / self._steps[1]

    def current(self, psi: complex, i: complex) -> complex:
        """Current [A] of a flux linkage by Newton's iteration from a near one."""
        for _ in range(NEWTON_STEPS):
            at, d, q = self.flux(i)
            error, determinant = psi - at, d.real * q.imag - d.imag * q.real
            i += complex(
                (error.real * q.imag - error.imag * q.real) / determinant,
                (error.imag * d.real - error.real * d.imag) / determinant,
            )
        return i


def ripple_of(wave: Array) -> Array:
    """A phase current over a turn without its fundamental [A], shape (k,)."""
    spectrum = np.fft.rfft(wave)
    spectrum[1] = 0.0
    ripple: Array = np.fft.irfft(spectrum, len(wave))
    return ripple


def _harmonics_percent(wave: Array) -> float:
    spectrum = np.abs(np.fft.rfft(wave))
    return 100.0 * float(np.hypot(spectrum[5], spectrum[7]) / max(spectrum[1], 1e-30))
