"""Capabilities of the simulated drive, and the excitations that it refuses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from orchestrator.driving import SINGLE_PRECISION_RATIO
from plugins.drives.simulated._derive import Nameplate, TruePlant
from plugins.drives.simulated._derive_switching import carrier_frequencies, declared_delay
from plugins.drives.simulated._map import describe_misfit
from plugins.drives.simulated._state import SQRT3
from plugins.drives.simulated.options import SimulatedOptions
from protocols import Capabilities, DriveRefused, Excitation, Injection, InputError, Spin, Trapezoid, VoltageSteps

KINDS = frozenset({"gates_off", "hold", "trapezoid", "injection", "steps", "spin"})


@dataclass(frozen=True)
class Permission:
    """The drive's own limits."""

    capabilities: Capabilities
    reach_positive_d_a: float
    max_angle_step: ClassVar[float] = 0.5
    """Largest electrical rotor angle between two rows [rad]."""

    @classmethod
    def of(
        cls, options: SimulatedOptions, nameplate: Nameplate, plant: TruePlant, bus_v: float, notes: tuple[str, ...]
    ) -> Permission:
        """Limits by the options, or else by the nameplate."""
        pwm = options.pwm_frequency_hz or options.sampling_frequency_hz
        table = plant.table
        reach = min(2.5 * nameplate.rated_a, plant.reach_a)
        if options.max_voltage_v is not None and options.max_voltage_v > bus_v / SQRT3 * SINGLE_PRECISION_RATIO:
            raise InputError("drive", "max_voltage_v", f"the bus of {bus_v:g} V gives {bus_v / SQRT3:.4g} V at most")
        capabilities = Capabilities(
            name="simulated",
            sampling_frequency_hz=options.sampling_frequency_hz,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=carrier_frequencies(options),
            dc_bus_voltage_v=bus_v,
            voltage_delay_samples=declared_delay(options),
            max_current_a=min(options.max_current_a or reach, plant.reach_a),
            max_voltage_v=options.max_voltage_v or bus_v / SQRT3,
            longest_capture_s=options.longest_capture_s,
            excitations=KINDS,
            watchdog_s=options.watchdog_s,
            watchdog_covers=KINDS if options.watchdog_s is not None else frozenset(),
            clock_is_simulated=True,
            has_brake=options.has_brake,
            interlocks=options.interlocks,
            simulated=True,
            motor_name=table.motor.name if table is not None and table.motor is not None else None,
            notes=(*notes, *((describe_misfit(table, plant.magnetics),) if table is not None else ())),
        )
        return cls(capabilities, plant.reach_positive_d_a)

    def check(self, excitation: Excitation, *, braked: bool) -> None:
        """Raises `DriveRefused` for an excitation that control or motor cannot realise."""
        fs = self.capabilities.sampling_frequency_hz
        if excitation.control.bandwidth_hz > fs / 10:
            raise DriveRefused(f"bandwidth {excitation.control.bandwidth_hz:g} Hz is above a tenth of the sampling")
        largest_d_a = excitation.start_dq_a[0]
        if isinstance(excitation, VoltageSteps):
            largest_d_a = excitation.turn_d_a
        elif isinstance(excitation, Trapezoid):
            largest_d_a += excitation.amplitude_a * {"d": 1.0, "q": 0.0, "dq": math.sqrt(0.5)}[excitation.swept_axis]
        if largest_d_a > self.reach_positive_d_a * SINGLE_PRECISION_RATIO:
            raise DriveRefused(f"i_d above {self.reach_positive_d_a:.4g} A: this motor's flux map does not reach there")
        if isinstance(excitation, Injection) and max(excitation.frequency_hz, excitation.rotation_hz) > 0.5 * fs:
            raise DriveRefused(f"injection at {excitation.frequency_hz:g} Hz is above half the sampling frequency")
        if isinstance(excitation, Spin) and braked:
            raise DriveRefused("the brake holds the rotor")
        if isinstance(excitation, Spin) and (speed := abs(excitation.speed_rad_s)) > self.max_angle_step * fs:
            raise DriveRefused(f"{speed:g} rad/s: more than {self.max_angle_step:g} rad between two rows")
