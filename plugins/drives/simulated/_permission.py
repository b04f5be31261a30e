"""What the simulated drive says it can do, and what it refuses. It moves nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plugins.drives.simulated._derive import Nameplate, TruePlant
from plugins.drives.simulated._plant import SQRT3
from plugins.drives.simulated.options import SimulatedOptions
from protocols import Capabilities, DriveRefused, Excitation, Injection, InputError, Limits, Trapezoid

KINDS = frozenset({"gates_off", "hold", "trapezoid", "injection"})
ROUNDING = 1.0 + 1e-9


@dataclass(frozen=True)
class Permission:
    """The drive's own limits."""

    capabilities: Capabilities
    nameplate: Nameplate
    reach_positive_d_a: float

    @classmethod
    def of(cls, options: SimulatedOptions, nameplate: Nameplate, plant: TruePlant, bus_v: float) -> Permission:
        """Limits from the options; what is left out follows from the nameplate."""
        pwm = options.pwm_frequency_hz or options.sampling_frequency_hz
        choices = options.pwm_frequencies_hz or (0.5 * pwm, pwm, 2.0 * pwm)
        table = plant.table
        reach = min(2.5 * nameplate.rated_a, plant.reach_a)
        if options.max_voltage_v is not None and options.max_voltage_v > bus_v / SQRT3 * ROUNDING:
            raise InputError("drive", "max_voltage_v", f"the bus of {bus_v:g} V gives {bus_v / SQRT3:.4g} V at most")
        capabilities = Capabilities(
            name="simulated",
            sampling_frequency_hz=options.sampling_frequency_hz,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=tuple(sorted({*choices, pwm})),
            dc_bus_voltage_v=bus_v,
            voltage_delay_samples=options.voltage_delay_samples,
            max_current_a=min(options.max_current_a or reach, plant.reach_a),
            max_voltage_v=options.max_voltage_v or bus_v / SQRT3,
            longest_capture_s=options.longest_capture_s,
            excitations=KINDS,
            watchdog_s=options.watchdog_s,
            watchdog_covers=KINDS if options.watchdog_s is not None else frozenset(),
            has_brake=options.has_brake,
            motor_name=table.motor.name if table is not None and table.motor is not None else None,
        )
        return cls(capabilities, nameplate, plant.reach_positive_d_a)

    def check_limits(self, limits: Limits) -> None:
        """Raises `DriveRefused` where a limit is above the drive's own."""
        own = self.capabilities
        if limits.current_a > own.max_current_a * ROUNDING:
            raise DriveRefused(f"current limit {limits.current_a:g} A is above the drive's {own.max_current_a:g} A")
        if limits.voltage_v > own.max_voltage_v * ROUNDING:
            raise DriveRefused(f"voltage limit {limits.voltage_v:g} V is above the drive's {own.max_voltage_v:g} V")

    def check(self, excitation: Excitation, limits: Limits) -> None:
        """Raises `DriveRefused` for what this drive, or the limits, do not allow."""
        own, fs = self.capabilities, self.capabilities.sampling_frequency_hz
        for field, value in excitation:
            if isinstance(value, float) and not math.isfinite(value):
                raise DriveRefused(f"{field} is not a finite number")
        pwm = excitation.pwm_frequency_hz
        if pwm is not None and not any(math.isclose(pwm, f) for f in own.pwm_frequencies_hz):
            choices = ", ".join(f"{f:g}" for f in own.pwm_frequencies_hz)
            raise DriveRefused(f"PWM frequency {pwm:g} Hz; this drive has {choices} Hz")
        if excitation.control.bandwidth_hz > fs / 10:
            raise DriveRefused(f"bandwidth {excitation.control.bandwidth_hz:g} Hz is above a tenth of the sampling")
        captured_s = excitation.captured_s
        if captured_s * fs < 0.5:
            raise DriveRefused(f"nothing to capture: {captured_s:g} s is less than a sample")
        if own.longest_capture_s is not None and captured_s > own.longest_capture_s * ROUNDING:
            raise DriveRefused(f"capture of {captured_s:g} s is longer than the drive's {own.longest_capture_s:g} s")
        current_a = excitation.longest_current_a
        if current_a > limits.current_a * ROUNDING:
            raise DriveRefused(f"current {current_a:.4g} A is above the limit of {limits.current_a:g} A")
        if _largest_d(excitation) > self.reach_positive_d_a * ROUNDING:
            raise DriveRefused(f"i_d above {self.reach_positive_d_a:.4g} A: this motor is not known there")
        if isinstance(excitation, Injection):
            self._check_injection(excitation, current_a, limits)

    def _check_injection(self, excitation: Injection, current_a: float, limits: Limits) -> None:
        fs = self.capabilities.sampling_frequency_hz
        if excitation.frequency_hz > 0.5 * fs or excitation.rotation_hz > 0.5 * fs:
            raise DriveRefused(f"injection at {excitation.frequency_hz:g} Hz is above half the sampling frequency")
        voltage = excitation.amplitude_v + self.nameplate.resistance_ohm * current_a
        if voltage > limits.voltage_v * ROUNDING:
            raise DriveRefused(
                f"injection of {excitation.amplitude_v:g} V at {current_a:.4g} A needs {voltage:.4g} V, "
                f"above the limit of {limits.voltage_v:g} V"
            )


def _largest_d(excitation: Excitation) -> float:
    start = excitation.start_dq_a[0]
    if not isinstance(excitation, Trapezoid):
        return start
    return start + excitation.amplitude_a * {"d": 1.0, "q": 0.0, "dq": math.sqrt(0.5)}[excitation.swept_axis]
