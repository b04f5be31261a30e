"""Converts excitations, limits and nameplates to registers and back, and faults to errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from plugins.wire._interlocks import interlock_text
from plugins.wire._messages import Fault
from plugins.wire._rows import CaptureFormat, Channel
from protocols import (
    CurrentControl,
    DriveFault,
    DriveRefused,
    Excitation,
    ExcitationKind,
    FaultCause,
    GatesOff,
    Hold,
    Injection,
    Limits,
    Motor,
    Trapezoid,
)

KINDS: tuple[ExcitationKind, ...] = ("gates_off", "hold", "trapezoid", "injection")
"""Supported excitations in the order of their numbers (program_kind) and bits (excitations, watchdog_covers)."""
AXES = ("d", "q", "dq")
WAVEFORMS = ("square", "sine")

Registers = dict[str, float]

_MODELS: Mapping[ExcitationKind, type[Excitation]] = {
    "gates_off": GatesOff,
    "hold": Hold,
    "trapezoid": Trapezoid,
    "injection": Injection,
}
_FIELDS: Mapping[ExcitationKind, tuple[str, ...]] = {
    "gates_off": ("duration_s",),
    "hold": ("current_d_a", "current_q_a", "settle_s", "duration_s"),
    "trapezoid": ("swept_axis", "held_a", "amplitude_a", "period_s", "periods", "settle_s"),
    "injection": (
        *("target_d_a", "target_q_a", "settle_s", "discard_s", "duration_s"),
        *("amplitude_v", "frequency_hz", "rotation_hz", "waveform"),
    ),
}
"""Fields of an excitation with a register, in the order of writing."""
_REGISTER_OF = {"target_d_a": "current_d_a", "target_q_a": "current_q_a"}
"""Field by register, where the names differ."""
_CHOICES: Mapping[str, tuple[str, ...]] = {"swept_axis": AXES, "waveform": WAVEFORMS}
_ON_GRID = ("settle_s", "discard_s", "duration_s")

_CAUSES = {
    Fault.OVERCURRENT: FaultCause.OVERCURRENT,
    Fault.OVERLOAD: FaultCause.OVERTEMPERATURE,
    Fault.WATCHDOG: FaultCause.HEARTBEAT_LOST,
    Fault.BUS_VOLTAGE: FaultCause.BUS_VOLTAGE,
    Fault.OVERTEMPERATURE: FaultCause.OVERTEMPERATURE,
    Fault.PROGRAM_TOO_LONG: FaultCause.PROGRAM_TOO_LONG,
    Fault.SENSOR: FaultCause.WRONG_DATA,
    Fault.LIMIT: FaultCause.PROGRAM_TOO_LONG,
    Fault.ENCODER: FaultCause.WRONG_DATA,
    Fault.EMERGENCY_STOP: FaultCause.EMERGENCY_STOP,
    Fault.INTERLOCK: FaultCause.EMERGENCY_STOP,
}
_WORDS = {
    Fault.OVERCURRENT: ("overcurrent", "A"),
    Fault.OVERLOAD: ("overload (i²t)", ""),
    Fault.WATCHDOG: ("no heartbeat", "s"),
    Fault.BUS_VOLTAGE: ("DC-bus voltage", "V"),
    Fault.OVERTEMPERATURE: ("temperature", "°C"),
    Fault.PROGRAM_TOO_LONG: ("the program did not end", "s"),
    Fault.LIMIT: ("the experiment's energy or duration is used up", ""),
}


# Programs


def program_registers(excitation: Excitation, sampling_frequency_hz: float) -> Registers:
    """Registers to write before run_program, without capture and ripple settings.

    Times are rounded to the sampling grid first, so that rounding to singles cannot change the number of rows.
    """
    if excitation.kind not in _FIELDS:
        raise DriveRefused(f"the protocol has no program for {excitation.kind}")
    values = {
        "program_kind": float(KINDS.index(excitation.kind)),
        "rotor_angle_rad": excitation.rotor_angle_rad,
        "pwm_frequency_asked_hz": excitation.pwm_frequency_hz or 0.0,
        "control_bandwidth_hz": excitation.control.bandwidth_hz,
        "control_damping": excitation.control.damping,
    }
    for field in _FIELDS[excitation.kind]:
        value = getattr(excitation, field)
        if field in _CHOICES:
            value = _CHOICES[field].index(value)
        elif field in _ON_GRID:
            value = round(value * sampling_frequency_hz) / sampling_frequency_hz
        values[_REGISTER_OF.get(field, field)] = float(value)
    return values


def program_of(values: Mapping[str, float]) -> Excitation:
    """The excitation in a drive's registers.

    Raises pydantic's `ValidationError` (a `ValueError`) for an invalid excitation; a drive then
    refuses run_program with out_of_range.
    """
    kind = KINDS[int(values["program_kind"])]
    fields: dict[str, object] = {
        "rotor_angle_rad": values["rotor_angle_rad"],
        "pwm_frequency_hz": values["pwm_frequency_asked_hz"] or None,
        "control": CurrentControl(bandwidth_hz=values["control_bandwidth_hz"], damping=values["control_damping"]),
    }
    for field in _FIELDS[kind]:
        value = values[_REGISTER_OF.get(field, field)]
        fields[field] = _CHOICES[field][int(value)] if field in _CHOICES else value
    return _MODELS[kind].model_validate(fields)


# Limits and nameplate


def limit_registers(limits: Limits) -> Registers:
    """Registers of limits, to be written and read back before arming."""
    return {
        "limit_current_a": limits.current_a,
        "limit_voltage_v": limits.voltage_v,
        "limit_energy_j": limits.energy_j or 0.0,
        "limit_duration_s": limits.duration_s or 0.0,
    }


def limits_of(values: Mapping[str, float]) -> Limits:
    """The limits in a drive's registers; raises `ValidationError` where current or voltage is 0."""
    return Limits(
        current_a=values["limit_current_a"],
        voltage_v=values["limit_voltage_v"],
        energy_j=values["limit_energy_j"] or None,
        duration_s=values["limit_duration_s"] or None,
    )


def motor_registers(motor: Motor) -> Registers:
    """Registers of the nameplate, for current control and i²t; 0 for unknown values."""
    return {
        "motor_pole_pairs": float(motor.pole_pairs),
        "motor_resistance_ohm": motor.stator_resistance_ohm or 0.0,
        "motor_inductance_d_h": motor.d_inductance_h or 0.0,
        "motor_inductance_q_h": motor.q_inductance_h or 0.0,
        "motor_flux_wb": motor.pm_flux_wb or 0.0,
        "motor_rated_current_a": motor.rated_current_a or 0.0,
    }


# Captures and faults


def capture_registers(
    channels: Channel, form: CaptureFormat = CaptureFormat.INT16, *, ripple_periods: int = 0
) -> Registers:
    """Registers that select what a program captures and demodulates."""
    return {
        "capture_mask": float(channels),
        "capture_format": float(form),
        "ripple_periods": float(ripple_periods),
        "ripple_live": 0.0,
    }


def drive_fault(
    cause: Fault, value: float = 0.0, limit: float = 0.0, faults: int = 0, interlocks: Sequence[str] = ()
) -> DriveFault:
    """`DriveFault` of a drive's fault: the first cause in words, then the later ones.

    `interlocks` are the names of the drive's inputs.
    """
    text, unit = _WORDS.get(cause, (cause.name.lower().replace("_", " "), ""))
    detail = f"{text}: {value:.4g} {unit} against {limit:.4g} {unit}".replace("  ", " ").rstrip() if unit else text
    if cause is Fault.INTERLOCK:
        detail = interlock_text(int(value), interlocks)
    others = [fault.name.lower() for fault in Fault if fault not in (Fault.NONE, cause) and faults >> fault & 1]
    if others:
        detail += f" (then {', '.join(others)})"
    return DriveFault(_CAUSES.get(cause, FaultCause.INTERNAL), detail)
