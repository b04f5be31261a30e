"""What the drive may do: largest current, bus voltage, largest speed, sampling frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orchestrator.formatting.quantities import number, quantity
from orchestrator.tuning.machine import Machine
from protocols import DriveRecord, InputError

WHERE = "limits"
MIN_SAMPLES_PER_TURN: float = 10.0
"""Samples in an electrical turn at the largest speed, below which a current control per period is not designed: its
delay of 1.5 samples would turn the voltage by 54 degrees."""
VOLTAGE_RESERVE: float = 0.05
"""Part of the voltage that the references leave to the current control and to errors of the map."""
PLAUSIBLE: dict[str, tuple[float, float]] = {
    "bus_v": (1.0, 1e5),
    "speed_rpm": (1.0, 1e6),
    "sampling_hz": (100.0, 1e6),
    "pwm_hz": (100.0, 1e6),
}
"""Least and greatest values of given limits: outside, a unit is wrong."""
MIN_CURRENT_RATIO: float = 1e-2
"""Least current limit over the largest measured current: below, the map has no points to tell."""


@dataclass(frozen=True)
class DriveLimits:
    """Limits that the references keep.

    Attributes
    ----------
    current_a : float
        Largest length of the current vector [A peak].
    bus_v : float
        DC bus voltage [V].
    speed_rad_s : float
        Largest electrical speed [rad/s].
    sampling_hz : float
        Frequency of the current control, which updates the voltage once in a period; with a double update, twice
        `pwm_hz`. The control's delay follows from it.
    pwm_hz : float
        Frequency of the PWM, which the inverter's loss follows.
    """

    current_a: float
    bus_v: float
    speed_rad_s: float
    sampling_hz: float
    pwm_hz: float

    @property
    def voltage_v(self) -> float:
        """Largest length of a voltage vector in every direction [V peak]: the circle inside the hexagon."""
        return self.bus_v / math.sqrt(3.0)


def limits_of(
    machine: Machine,
    drive: DriveRecord | None,
    *,
    current_a: float | None = None,
    bus_v: float | None = None,
    speed_rpm: float | None = None,
    sampling_hz: float | None = None,
    pwm_hz: float | None = None,
) -> DriveLimits:
    """Limits as given, else as the nameplate and the recording's drive have them.

    Parameters
    ----------
    machine : Machine
    drive : DriveRecord or None
        The drive that the motor was measured with.
    current_a : float, optional
        [A peak]; by default the rated one, or the largest measured one where that is smaller or there is none.
    bus_v : float, optional
        [V]; by default the recording's.
    speed_rpm : float, optional
        Mechanical [1/min]; by default the rated one, or else that at which the magnet alone takes the whole voltage.
    sampling_hz : float, optional
        [Hz]; by default the PWM's.
    pwm_hz : float, optional
        [Hz]; by default the recording's, or `sampling_hz` where that has none.

    Raises
    ------
    InputError
        Where a limit is missing, not positive, beyond what was measured, or excludes another one.
    """
    measured = machine.largest_current_a
    rated = machine.motor.rated_current_a
    given = {
        "current_a": current_a,
        "bus_v": bus_v,
        "speed_rpm": speed_rpm,
        "sampling_hz": sampling_hz,
        "pwm_hz": pwm_hz,
    }
    for name, value in given.items():
        option = f"(--{name.replace('_', '-')})"
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise InputError(WHERE, name, f"expected a positive number, not {value:g} {option}")
        low, high = PLAUSIBLE.get(name, (MIN_CURRENT_RATIO * measured, math.inf))
        if value is not None and not low <= value <= high:
            bound = f"{number(low, 3)} or more" if value < low else f"{number(high, 3)} or less"
            raise InputError(WHERE, name, f"expected {bound}, not {number(value)} {option}: is it in the right unit?")
    if current_a is not None and current_a > measured * (1.0 + 1e-6):
        wanted, reached = quantity(current_a, "A"), quantity(measured, "A")
        raise InputError(WHERE, "current_a", f"{wanted} peak is beyond the map, which was measured up to {reached}")
    current = current_a or min(rated or measured, measured)
    bus = bus_v or (drive.dc_bus_voltage_v if drive is not None else None)
    if bus is None:
        raise InputError(WHERE, "bus_v", "unknown; give the DC bus voltage (--bus-v)")
    pwm = pwm_hz or (drive.pwm_frequency_hz if drive is not None else None) or sampling_hz
    sampling = sampling_hz or pwm
    if sampling is None or pwm is None:
        raise InputError(WHERE, "sampling_hz", "unknown; give the frequency of the current control (--sampling-hz)")
    usable = (1.0 - VOLTAGE_RESERVE) * bus / math.sqrt(3.0)
    if machine.r_s_ohm * current >= usable:
        drop, most = quantity(machine.r_s_ohm * current, "V"), quantity(usable, "V")
        needed, allowed = number(bus * machine.r_s_ohm * current / usable, 3), number(usable / machine.r_s_ohm, 3)
        text = f"R_s alone takes {drop} of the {most} that the bus allows"
        advice = f"give a bus above {needed} V (--bus-v) or a current below {allowed} A peak (--current-a)"
        raise InputError(WHERE, "bus_v", f"{text}: {advice}")
    speed = _largest_speed(machine, speed_rpm, bus)
    fastest = 2.0 * math.pi * sampling / MIN_SAMPLES_PER_TURN
    if speed > fastest:
        if speed_rpm is None:
            speed = fastest
        else:
            rpm = fastest / machine.pole_pairs * 30.0 / math.pi
            text = (
                f"{sampling:g} Hz suffices up to {rpm:.0f} rpm: {MIN_SAMPLES_PER_TURN:g} samples in an electrical turn"
            )
            raise InputError(WHERE, "speed_rpm", text)
    return DriveLimits(current, bus, speed, sampling, pwm)


def _largest_speed(machine: Machine, speed_rpm: float | None, bus_v: float) -> float:
    """Largest electrical speed [rad/s]: the given, the rated, or that of the no-load voltage."""
    rpm = speed_rpm or machine.motor.rated_speed_rpm
    if rpm is not None:
        return rpm * machine.pole_pairs * math.pi / 30.0
    magnet = machine.motor.pm_flux_wb
    if not magnet:
        raise InputError(WHERE, "speed_rpm", "unknown; give the largest speed (--speed-rpm)")
    return bus_v / math.sqrt(3.0) / magnet
