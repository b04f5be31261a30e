"""One axis of an ODrive: configuration, a current at an angle, readings. Properties are named as in firmware 0.5.6.

In torque control the board holds a current along q of its encoder's frame. The encoder's phase offset rotates that
frame against the rotor, which gives the current the requested direction (encoder.cpp, motor.cpp):

    theta = direction 2 pi p / cpr (counts - offset),      i_q = direction torque / K_t.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from plugins.drives.odrive._properties import Properties
from protocols import DriveFault, DriveRefused, FaultCause

IDLE, CLOSED_LOOP = 1, 8
HIGH_CURRENT, TORQUE_CONTROL, PASSTHROUGH = 0, 1, 1
MAX_STATE_CHANGE_S = 1.0
"""Time in which the axis has to reach a requested state."""
MAX_FRAME_TURN_S = 0.3
"""Time in which the frame has to reach its angle."""
CURRENT_MARGIN_RATIO = 0.5
"""The board's trip margin above the current limit, over the limit."""
MAX_FRAME_ERROR_RAD = 0.05
"""Largest error of the frame's angle, by the encoder's resolution and motion of the rotor."""
ERROR_SOURCES = ("", ".motor", ".encoder", ".controller")
RUN_SETTINGS = (
    "config.enable_watchdog",
    "config.watchdog_timeout",
    "motor.config.current_lim",
    "motor.config.current_lim_margin",
    "controller.config.control_mode",
    "controller.config.input_mode",
    "encoder.config.phase_offset_float",
)
"""Properties set for a run and restored in this order, so that an active watchdog never has a timeout of zero."""
CONFIGURATION = (
    "motor.config.motor_type",
    "motor.is_calibrated",
    "encoder.is_ready",
    "motor.config.pole_pairs",
    "encoder.config.cpr",
    "encoder.config.direction",
    "motor.config.torque_constant",
    "controller.config.vel_limit",
)


@dataclass(frozen=True)
class Errors:
    """Latched error codes of the axis and its parts; 0 without an error."""

    axis: int
    motor: int
    encoder: int
    controller: int

    WATCHDOG = 1 << 11

    def __bool__(self) -> bool:
        return bool(self.axis or self.motor or self.encoder or self.controller)

    def __str__(self) -> str:
        return f"axis {self.axis:#x}, motor {self.motor:#x}, encoder {self.encoder:#x}, controller {self.controller:#x}"


class Axis:
    """An axis of a board, by a line.

    Parameters
    ----------
    line : Properties
    number : int
        0 or 1.
    """

    def __init__(self, line: Properties, number: int) -> None:
        self._line, self._number, self._name = line, number, f"axis{number}"
        self._own: dict[str, float] = {}
        self._facts: dict[str, float] = {}
        self.check, self.close = line.check, line.close

    def read_configuration(self) -> None:
        """Read the configuration; raises `DriveRefused` where it is unsuitable."""
        self._own = self._read(RUN_SETTINGS)
        self._facts = facts = self._read(CONFIGURATION)
        where = f"{self._line.where}, {self._name}"
        if facts["motor.config.motor_type"] != HIGH_CURRENT:
            raise DriveRefused(f"{where}: motor_type is not HIGH_CURRENT")
        if not facts["motor.is_calibrated"]:
            raise DriveRefused(f"{where}: the motor is not calibrated")
        if not facts["encoder.is_ready"] or facts["encoder.config.direction"] not in (-1.0, 1.0):
            raise DriveRefused(f"{where}: the encoder is not calibrated, by whose phase a current is held")
        if not facts["motor.config.torque_constant"] > 0.0:
            raise DriveRefused(f"{where}: no torque_constant, which turns torque into current")

    @property
    def pole_pairs(self) -> int:
        return int(self._facts["motor.config.pole_pairs"])

    @property
    def own_limit_a(self) -> float:
        return self._own["motor.config.current_lim"]

    def bus_v(self) -> float:
        """DC-bus voltage [V]."""
        return self._line.read(["vbus_voltage"])[0]

    def state(self) -> int:
        """The axis' state (`AxisState` of the firmware)."""
        return int(self._line.read([f"{self._name}.current_state"])[0])

    def errors(self) -> Errors:
        """The latched errors."""
        return Errors(*map(int, self._line.read([f"{self._name}{part}.error" for part in ERROR_SOURCES])))

    def clear(self) -> None:
        """Clear the errors of both axes."""
        self._line.send("sc")

    def feed(self) -> None:
        """Feed the watchdog."""
        self._line.send(f"u {self._number}")

    # Power stage

    def switch_on(self, current_a: float, watchdog_s: float) -> None:
        """Enter closed loop at zero torque, with a current limit and the watchdog."""
        self._write(
            {
                "motor.config.current_lim": current_a,
                "motor.config.current_lim_margin": CURRENT_MARGIN_RATIO * current_a,
                "config.watchdog_timeout": watchdog_s,
                "controller.config.control_mode": TORQUE_CONTROL,
                "controller.config.input_mode": PASSTHROUGH,
            }
        )
        self._torque(0.0)
        self.feed()
        self._write({"config.enable_watchdog": 1})
        self._enter(CLOSED_LOOP)

    def switch_off(self) -> None:
        """Go idle and restore the configuration."""
        self._torque(0.0)
        self._enter(IDLE)
        integers = ("enable_watchdog", "control_mode", "input_mode")
        self._write({k: int(v) if k.rpartition(".")[2] in integers else v for k, v in self._own.items()})

    def hold(self, current_a: float, angle_rad: float) -> None:
        """Hold a current along a stator angle: zero torque, rotation of the frame, then the current."""
        self._torque(0.0)
        target_rad = angle_rad - 0.5 * math.pi
        deadline = time.monotonic() + MAX_FRAME_TURN_S
        while (error_rad := self._frame_error(target_rad)) is not None:
            if time.monotonic() > deadline:
                raise DriveFault(FaultCause.WRONG_DATA, f"the encoder's frame is off its angle by {error_rad:.3f} rad")
            self._turn(error_rad)
        direction, constant = self._facts["encoder.config.direction"], self._facts["motor.config.torque_constant"]
        self._torque(direction * constant * current_a)

    def reading(self) -> np.ndarray:
        """i_alpha, i_beta [A], v_alpha, v_beta, v_dc [V], not sampled simultaneously."""
        control = f"{self._name}.motor.current_control"
        names = ("Ialpha_measured", "Ibeta_measured", "final_v_alpha", "final_v_beta")
        return np.array(self._line.read([*(f"{control}.{name}" for name in names), "vbus_voltage"]))

    def _frame_error(self, target_rad: float) -> float | None:
        """Error of the frame's angle [rad]; None within the tolerance."""
        (phase,) = self._line.read([f"{self._name}.motor.current_control.phase"])
        error_rad = math.remainder(target_rad - phase, 2.0 * math.pi)
        return None if abs(error_rad) <= MAX_FRAME_ERROR_RAD else error_rad

    def _turn(self, by_rad: float) -> None:
        name = "encoder.config.phase_offset_float"
        facts = self._facts
        counts = facts["encoder.config.cpr"] / (2.0 * math.pi * facts["motor.config.pole_pairs"])
        (now,) = self._read([name]).values()
        self._write({name: now - facts["encoder.config.direction"] * by_rad * counts})

    def _torque(self, torque_nm: float) -> None:
        self._line.send(f"c {self._number} {torque_nm:.7f}")

    def _enter(self, state: int) -> None:
        self._line.send(f"w {self._name}.requested_state {state}")
        deadline = time.monotonic() + MAX_STATE_CHANGE_S
        while (now := self.state()) != state:
            if time.monotonic() > deadline:
                message = f"{self._name} is in state {now}, not {state} ({self.errors()})"
                raise DriveFault(FaultCause.NO_ANSWER, f"{self._line.where}: {message}")

    def _read(self, names: Any) -> dict[str, float]:
        return dict(zip(names, self._line.read([f"{self._name}.{name}" for name in names]), strict=True))

    def _write(self, values: dict[str, float]) -> None:
        self._line.write({f"{self._name}.{name}": value for name, value in values.items()})
