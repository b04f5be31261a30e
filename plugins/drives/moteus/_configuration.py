"""What a board's configuration means for a drive: its frame, its capabilities, or why it cannot be used."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass

from plugins.drives.moteus._bounds import BOUNDS
from plugins.drives.moteus._faults import Mode
from plugins.drives.moteus._options import MoteusOptions
from protocols import Capabilities, DriveFault, DriveRefused, FaultCause, Motor

_SAFE_TIMEOUTS = (Mode.STOPPED, Mode.ZERO_VELOCITY, Mode.BRAKE)
"""`servo.timeout_mode`: where no current is driven any more once the rotor stands; mode 10 goes on positioning."""


def require_known(versions: Mapping[str, int], where: str) -> None:
    """Raises `DriveRefused` where the board's registers may mean something else than they do here."""
    version = versions.get("register_map_version")
    if version != BOUNDS.register_map_version:
        raise DriveRefused(
            f"{where}: register map {version}, expected {BOUNDS.register_map_version}; update it (moteus_tool --flash)"
        )


@dataclass(frozen=True)
class Frame:
    """Electrical angles as the positions that a moteus is commanded by, and vectors in the stator frame.

    With a fixed current commanded, the firmware takes its electrical angle from the commanded position alone (firmware,
    `ISR_CalculateDerivedQuantities`): ``theta = zero + sign * position / ratio * poles / 2 * 2 pi``. Its Clarke and
    Park transforms are amplitude-invariant (`fw/foc.h`), its q axis is turned by the sign of the output. The zero
    depends on where the output's origin was put, and is read from the board.
    """

    poles: int
    sign: int
    ratio: float
    zero_rad: float = 0.0

    def position(self, theta_rad: float) -> float:
        """Position [revolutions of the output] at this electrical angle: the one nearest to zero."""
        from_zero = math.remainder(theta_rad - self.zero_rad, 2.0 * math.pi)
        return self.sign * self.ratio * from_zero / (math.pi * self.poles)

    def stator(self, d: float, q: float, theta_rad: float) -> complex:
        """Stator-frame vector alpha + j beta of what the board calls d and q at this electrical angle."""
        return complex(d, self.sign * q) * cmath.exp(1j * theta_rad)


@dataclass(frozen=True)
class Configuration:
    """Of all that a board is configured for, what matters here."""

    frame: Frame
    max_current_a: float
    pwm_frequency_hz: float
    timeout_mode: int

    @classmethod
    def of(cls, numbers: Mapping[str, float], motor: Motor, where: str) -> Configuration:
        """Understand a configuration.

        Raises
        ------
        DriveRefused
            Where it has no current control, or is for another motor.
        """
        for name in ("servo.voltage_mode_control", "servo.fixed_voltage_mode"):
            if numbers[name]:
                raise DriveRefused(f"{where}: {name} is set, so that the board controls no current")
        poles, sign = round(numbers["motor.poles"]), round(numbers["motor_position.output.sign"])
        ratio = numbers["motor_position.rotor_to_output_ratio"]
        if poles != 2 * motor.pole_pairs:
            message = f"configured for {poles} poles, the nameplate has {motor.pole_pairs} pole pairs"
            raise DriveRefused(f"{where}: {message}; moteus_tool --calibrate, or another nameplate")
        if abs(sign) != 1 or not ratio > 0.0:
            raise DriveFault(FaultCause.WRONG_DATA, f"{where}: output sign {sign} and ratio {ratio:g} are not valid")
        return cls(
            Frame(poles, sign, ratio),
            numbers["servo.max_current_A"],
            numbers["servo.pwm_rate_hz"],
            round(numbers["servo.timeout_mode"]),
        )

    def capabilities(self, options: MoteusOptions, firmware: int, bus_v: float) -> Capabilities:
        """What the drive says of itself. Raises `DriveFault` where the bus has no voltage."""
        if not bus_v > 0.0:
            raise DriveFault(FaultCause.WRONG_DATA, f"{options.where}: a bus voltage of {bus_v:g} V")
        covered = self.timeout_mode in _SAFE_TIMEOUTS
        return Capabilities(
            name=f"moteus (firmware {firmware >> 16 & 255}.{firmware >> 8 & 255}.{firmware & 255})",
            sampling_frequency_hz=options.sampling_frequency_hz,
            pwm_frequency_hz=self.pwm_frequency_hz,
            pwm_frequencies_hz=(self.pwm_frequency_hz,),
            dc_bus_voltage_v=bus_v,
            max_current_a=self.max_current_a,
            max_voltage_v=BOUNDS.max_modulation_ratio * bus_v,
            excitations=frozenset({"hold"}),
            watchdog_s=options.watchdog_s if covered else None,
            watchdog_covers=frozenset({"hold"}) if covered else frozenset(),
        )
