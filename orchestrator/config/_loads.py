"""Load of one excitation by the nameplate: current, voltage, copper loss; limits are checked elsewhere.

Copper loss is 3/2 R_s |i|^2 (peak-valued, amplitude-invariant vectors). The trapezoid's mean
square is 2/3 of its amplitude's: half the period at the amplitude, half on ramps (1/3). Voltage steps
overshoot their limits by U T / L, T being the drive's delay in reversing the voltage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orchestrator.config._planning import PlannedPoint
from orchestrator.stages import flux_swing_wb, ripple_a
from protocols import Excitation, Injection, Motor, Point, Spin, Trapezoid, VoltageSteps

_TRAPEZOID_MEAN_SQUARE = 2 / 3
_TRIANGLE_MEAN_SQUARE = 1 / 3


@dataclass(frozen=True)
class Load:
    """Load of one point; None where the nameplate lacks a value for it."""

    longest_current_a: float
    """Longest current vector of the set-points [A]."""
    ripple_a: float
    """Peak of the injection's ripple on top of it, or the overshoot of steps; 0 where no inductance is known."""
    current_square_a2_s: float
    """Time integral of |i|^2, settling included."""
    steady_voltage_v: float | None
    """Voltage required by the point: R_s i, ramps, injection."""
    control_voltage_v: float | None
    """Unlimited voltage of the current control's step from the previous point."""

    @property
    def peak_current_a(self) -> float:
        """Current and ripple [A]."""
        return self.longest_current_a + self.ripple_a


def load_of(point: PlannedPoint, previous: Point, motor: Motor, delay_s: float = 0.0) -> Load:
    """The load of a point that is approached from the current `previous` (i_d, i_q).

    Parameters
    ----------
    delay_s : float
        Delay from a current's limit crossing to the effect of the reversed voltage.
    """
    excitation = point.excitation
    current_a = excitation.longest_current_a
    ripple = nominal_ripple_a(excitation, motor, delay_s)
    resistance = motor.stator_resistance_ohm
    steady = control = None
    if isinstance(excitation, VoltageSteps):
        steady = control = excitation.voltage_v
    elif resistance is not None:
        steady = resistance * current_a + _driving_voltage(excitation, motor)
        control = resistance * current_a + _proportional_gain(excitation, motor) * math.dist(
            excitation.start_dq_a, previous
        )
    squared = _current_square(excitation, point) + _TRIANGLE_MEAN_SQUARE * _square(ripple) * point.captured_s
    return Load(current_a, ripple, squared, steady, control)


def nominal_ripple_a(excitation: Excitation, motor: Motor, delay_s: float = 0.0) -> float:
    """Peak of an injection's ripple on the axis of the nameplate's smaller inductance, or the overshoot of steps.

    In ampere; 0 where no inductance is known. `delay_s` as of `load_of`.
    """
    if isinstance(excitation, VoltageSteps):
        return ripple_a(excitation.voltage_v * delay_s, motor)
    if not isinstance(excitation, Injection):
        return 0.0
    return ripple_a(flux_swing_wb(excitation.amplitude_v, excitation.frequency_hz, excitation.waveform), motor)


def _driving_voltage(excitation: Excitation, motor: Motor) -> float:
    """Voltage on top of R_s i: the injection's amplitude, or L di/dt on a ramp [V]."""
    if isinstance(excitation, Injection):
        return excitation.amplitude_v
    if isinstance(excitation, Trapezoid):
        return _inductance(motor) * excitation.amplitude_a / (excitation.period_s / 8)
    if isinstance(excitation, Spin) and excitation.bridge == "on":
        flux = (motor.pm_flux_wb or 0.0) + _inductance(motor) * excitation.longest_current_a
        return abs(excitation.speed_rad_s) * flux
    return 0.0


def _proportional_gain(excitation: Excitation, motor: Motor) -> float:
    """Proportional gain of the PI control of an R-L axis with the required bandwidth and damping [V/A]."""
    control = excitation.control
    gain = 2 * control.damping * 2 * math.pi * control.bandwidth_hz * _inductance(motor)
    return max(0.0, gain - (motor.stator_resistance_ohm or 0.0))


def _current_square(excitation: Excitation, point: PlannedPoint) -> float:
    squared = _square(math.hypot(*excitation.start_dq_a)) * (excitation.settling_s + point.captured_s)
    if isinstance(excitation, Trapezoid):
        squared += _TRAPEZOID_MEAN_SQUARE * _square(excitation.amplitude_a) * point.captured_s
    if isinstance(excitation, VoltageSteps):
        squared += _TRIANGLE_MEAN_SQUARE * _square(excitation.longest_current_a) * point.captured_s
    return squared


def _square(x: float) -> float:
    """x^2; infinite on overflow, where ** would raise, so that limits refuse it."""
    return x * x


def _inductance(motor: Motor) -> float:
    return max(motor.d_inductance_h or 0.0, motor.q_inductance_h or 0.0)
