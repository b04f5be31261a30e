"""What a moteus says when something is wrong, in plain words. Decides nothing.

Codes: the register reference of moteus (docs/protocol/registers.md in github.com/mjbots/moteus), registers 0x000 and
0x00f.
"""

from __future__ import annotations

from enum import IntEnum

from protocols import DriveFault, FaultCause


class Mode(IntEnum):
    """The modes that matter here (register 0x000)."""

    STOPPED = 0
    FAULT = 1
    ENABLING = 2
    CALIBRATING = 3
    CALIBRATED = 4
    POSITION = 10
    TIMEOUT = 11
    ZERO_VELOCITY = 12
    BRAKE = 15


STARTING = (Mode.STOPPED, Mode.ENABLING, Mode.CALIBRATING, Mode.CALIBRATED)

_FAULTS: dict[int, tuple[FaultCause, str]] = {
    32: (FaultCause.INTERNAL, "the zero of the current sensors is out of range (calibration fault)"),
    33: (
        FaultCause.INTERNAL,
        "the gate driver reports a fault: most often the supply broke down under the current, else a short circuit",
    ),
    34: (FaultCause.BUS_VOLTAGE, "the bus voltage is above servo.max_voltage: the supply cannot take energy back"),
    35: (FaultCause.INTERNAL, "the encoder sees no magnet"),
    36: (FaultCause.INTERNAL, "the motor is not configured: run moteus_tool --calibrate first"),
    37: (FaultCause.INTERNAL, "PWM cycle overrun, an error of the firmware"),
    38: (FaultCause.OVERTEMPERATURE, "the board or the motor is hotter than configured"),
    39: (FaultCause.INTERNAL, "the rotor stands outside servopos.position_min and position_max"),
    40: (FaultCause.BUS_VOLTAGE, "the bus voltage is too low"),
    41: (FaultCause.INTERNAL, "the configuration was changed while the motor was under power"),
    42: (FaultCause.INTERNAL, "there is no valid commutation encoder"),
    43: (FaultCause.INTERNAL, "there is no valid output encoder"),
    44: (FaultCause.INTERNAL, "the gate driver cannot be enabled"),
    46: (FaultCause.INTERNAL, "timing violation, an error of the firmware"),
    47: (FaultCause.INTERNAL, "servo.bemf_feedforward is not zero; set it to zero to hold currents"),
    48: (FaultCause.INTERNAL, "servopos.position_min or position_max is out of range"),
}

_LIMITING: dict[int, str] = {
    96: "servo.max_velocity",
    97: "servo.max_power_W, or what the board can do at this bus voltage",
    98: "the bus voltage",
    99: "servo.max_current_A",
    100: "the temperature of the board",
    101: "the temperature of the motor",
    102: "the commanded torque",
    103: "servopos.position_min or position_max",
    104: "flux braking",
    105: "field weakening",
}


def fault_of(mode: int, code: int, watchdog_s: float) -> DriveFault | None:
    """The fault that mode and code stand for; None where there is none."""
    if mode == Mode.TIMEOUT:
        return DriveFault(FaultCause.HEARTBEAT_LOST, f"the board received no heartbeat for {watchdog_s:g} s (mode 11)")
    if mode != Mode.FAULT:
        return None
    cause, words = _FAULTS.get(code, (FaultCause.INTERNAL, "unknown to this version"))
    return DriveFault(cause, f"moteus fault {code}: {words}")


def limiting(code: int) -> str | None:
    """What keeps the current from its target, in words; None where nothing does."""
    return _LIMITING.get(code)
