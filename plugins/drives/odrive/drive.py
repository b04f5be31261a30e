"""The drive `odrive`: holds direct currents under the board's own current control, and reads them slowly.

It supports `hold` alone; docs/odrive.md gives the reasons.
"""

from __future__ import annotations

import cmath
import math
import time
from collections.abc import Generator, Iterator, Mapping
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field

from orchestrator.driving.polled import PolledDrive
from plugins.drives.odrive._axis import CLOSED_LOOP, IDLE, Axis, Errors
from plugins.drives.odrive._properties import Properties
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    Excitation,
    ExcitationKind,
    FaultCause,
    Hold,
    Limits,
    Strict,
    Telemetry,
)

FIRMWARE_VERSION = (0, 5)
MAX_RAMP_S = 0.5
"""Time in which the current has to fall to zero."""
CURRENT_DECAY_S = 0.01
"""Time for the residual current to decay."""
MAX_CAPTURE_ATTEMPTS = 10
MAX_READING_DELAY_S = 0.05
"""A reading later than this restarts the capture."""
TRIP_RATIO = 1.1
"""Measured current or voltage over its limit, above which the drive trips."""
ZERO_CURRENT_RATIO = 0.02
"""Current over its limit, below which it counts as zero."""
MIN_CURRENT_ERROR_RATIO = 0.05
"""Deviation from the set-point over the current limit, below which it is accepted."""
MAX_CURRENT_ERROR_RATIO = 0.3
"""Deviation from the set-point over the set-point, above which it is an error."""
MAX_MODULATION_RATIO = 0.8
"""Largest voltage vector of the board's modulation, times sqrt(3), over the bus voltage."""


class OdriveOptions(Strict):
    """Options of the drive `odrive`."""

    port: Annotated[str, Field(min_length=1, examples=["/dev/ttyACM0"])]
    """Serial device, or ``socket://host:port``."""
    baud_rate: Annotated[int, Field(ge=1)] = 115200
    """Baud rate of a UART; irrelevant on USB."""
    axis: Annotated[int, Field(ge=0, le=1)] = 0
    sampling_frequency_hz: Annotated[float, Field(ge=1.0, le=200.0)] = 40.0
    """Rate of readings while capturing."""
    watchdog_s: Annotated[float, Field(ge=0.1, le=10.0)] = 0.5
    """Timeout of the axis' watchdog during the run."""
    clear_fault: bool = False
    """Clear the board's latched errors on connecting; remove their cause first."""


class OdriveDrive(PolledDrive[Axis]):
    """An axis of an ODrive as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `OdriveOptions`.
    """

    name: ClassVar[str] = "odrive"
    Options: ClassVar[type[BaseModel]] = OdriveOptions
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {
        "gates_off": "it measures no current while it is idle",
        "trapezoid": "it gives a few dozen readings a second, with voltages of other instants than the currents",
        "injection": "it gives a few dozen readings a second, and its stock oscilloscope has no source",
        "steps": "it has no command that reverses a voltage at a current limit",
        "spin": "it supports a locked rotor only",
    }

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: OdriveOptions = setup.options

    # Link

    def open(self) -> Capabilities:
        """Read the board's version and configuration. Nothing is energised.

        Raises
        ------
        DriveFault
            No answer, or an unusable one.
        DriveRefused
            Firmware, configuration or nameplate do not fit, or another host controls the axis.
        """
        o = self._options
        line = Properties(o.port, o.baud_rate)
        self.board = axis = Axis(line, o.axis)
        version = tuple(map(int, line.read(["fw_version_major", "fw_version_minor", "fw_version_revision"])))
        if version[:2] != FIRMWARE_VERSION:
            raise DriveRefused(f"{line.where}: firmware {'.'.join(map(str, version))}, 0.5 is needed")
        axis.read_configuration()
        if axis.pole_pairs != self.setup.motor.pole_pairs:
            message = f"motor.config.pole_pairs is {axis.pole_pairs}, the nameplate's {self.setup.motor.pole_pairs}"
            raise DriveRefused(f"{line.where}: {message}")
        if axis.state() != IDLE:
            raise DriveRefused(f"{line.where}: axis {o.axis} is not idle: another host controls it")
        self._clear_stale_errors(axis)
        bus_v = axis.bus_v()
        if not 0.0 < bus_v < math.inf:
            raise DriveFault(FaultCause.BUS_VOLTAGE, f"{line.where}: reads a bus of {bus_v:g} V")
        self.origin_s = time.monotonic()
        return Capabilities(
            name="odrive",
            sampling_frequency_hz=o.sampling_frequency_hz,
            pwm_frequency_hz=24_000.0,
            pwm_frequencies_hz=(24_000.0,),
            dc_bus_voltage_v=bus_v,
            max_current_a=axis.own_limit_a,
            max_voltage_v=MAX_MODULATION_RATIO * bus_v / math.sqrt(3.0),
            heeds_bandwidth=False,
            excitations=frozenset(("hold",)),
            watchdog_s=o.watchdog_s,
            watchdog_covers=frozenset(("hold",)),
            notes=(f"firmware {'.'.join(map(str, version))}; held currents alone (docs/odrive.md)",),
        )

    def _clear_stale_errors(self, axis: Axis) -> None:
        """Clear an expired watchdog of an earlier host, and other errors only where `clear_fault` is set."""
        errors = axis.errors()
        if not errors:
            return
        if self._options.clear_fault or errors == Errors(Errors.WATCHDOG, 0, 0, 0):
            axis.clear()
        else:
            self.latch(_fault(errors, self._options.watchdog_s))

    def heartbeat(self) -> None:
        """Feed the watchdog while the power stage is on."""
        axis = self.board
        if axis is None or self.limits is None:
            return
        try:
            axis.feed()
        except DriveFault:
            return  # the line keeps the fault

    # Power stage

    def energise(self, limits: Limits) -> None:
        """Set the board's current limit and watchdog, then enter closed loop at zero torque."""
        axis = self.connected()
        try:
            axis.switch_on(min(limits.current_a, axis.own_limit_a), self._options.watchdog_s)
        except DriveFault as fault:
            raise self.trip(fault) from None

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Hold a current; refuses one that exceeds the voltage limit by the nameplate's resistance."""
        assert isinstance(excitation, Hold)
        assert self.limits is not None
        needed_v = excitation.longest_current_a * (self.setup.motor.stator_resistance_ohm or 0.0)
        if needed_v > self.limits.voltage_v:
            raise DriveRefused(f"needs {needed_v:.3g} V by the nameplate's resistance, above the limit")
        return self.tripping(self._hold_rows(excitation, self.limits))

    def _hold_rows(self, hold: Hold, limits: Limits) -> Generator[Capture]:
        axis = self.connected()
        self.aim(hold)
        axis.hold(*cmath.polar(self.target_a))
        yield from self.waiting(hold.settle_s)
        rows, start_s = yield from self._rows(axis, hold.rows(self.own.sampling_frequency_hz), limits)
        i, v = (rows[:, k] + 1j * rows[:, k + 1] for k in (0, 2))
        yield from self.blocks(i, v, start_s - self.origin_s, rows[:, 4])

    def _rows(self, axis: Axis, count: int, limits: Limits) -> Generator[Capture, None, tuple[np.ndarray, float]]:
        """Readings, one each period; restarted where one is late by more than `MAX_READING_DELAY_S`."""
        fs = self.own.sampling_frequency_hz
        for _ in range(MAX_CAPTURE_ATTEMPTS):
            rows, start_s = list[np.ndarray](), time.monotonic()
            yielded_s = start_s
            while len(rows) < count:
                time.sleep(max(0.0, start_s + len(rows) / fs - time.monotonic()))
                rows.append(axis.reading())
                self._watch(rows[-1], limits)
                if time.monotonic() > start_s + len(rows) / fs + MAX_READING_DELAY_S:
                    break
                if time.monotonic() - yielded_s > self.keepalive_period_s:
                    yielded_s = time.monotonic()
                    yield self.keepalive()
            else:
                time.sleep(max(0.0, start_s + count / fs - time.monotonic()))  # the last row lasts a period as well
                self.require_sound(self.board_fault())
                return np.array(rows), start_s
            yield self.keepalive()
        message = f"readings arrive late at {fs:g} Hz; choose a lower sampling_frequency_hz"
        raise DriveFault(FaultCause.NO_ANSWER, message)

    def _watch(self, row: np.ndarray, limits: Limits) -> None:
        i, v = math.hypot(row[0], row[1]), math.hypot(row[2], row[3])
        if i > TRIP_RATIO * limits.current_a:
            raise DriveFault(FaultCause.OVERCURRENT, f"{i:.3g} A flow, the limit is {limits.current_a:g} A")
        if v > TRIP_RATIO * limits.voltage_v:
            raise DriveFault(FaultCause.INTERNAL, f"{v:.3g} V are commanded, the limit is {limits.voltage_v:g} V")
        deviation_a = abs(complex(row[0], row[1]) - self.target_a)
        if deviation_a > max(MAX_CURRENT_ERROR_RATIO * abs(self.target_a), MIN_CURRENT_ERROR_RATIO * limits.current_a):
            self.require_sound(self.board_fault())
            message = f"{i:.3g} A flow, {deviation_a:.3g} A off the set-point of {abs(self.target_a):.3g} A"
            raise DriveFault(FaultCause.INTERNAL, f"{message}: the board limits it, or the rotor has turned")

    def telemetry(self) -> Telemetry:
        """A reading, now; its current is zero while the axis is idle, since none is measured then."""
        axis = self.connected()
        if self.limits is not None and not self.latched and (fault := self.board_fault()) is not None:
            self.trip(fault)
        alpha, beta, _, _, bus_v = axis.reading()
        flowing = axis.state() == CLOSED_LOOP
        i = complex(alpha, beta) * cmath.exp(-1j * self.rotor_angle_rad) if flowing else 0j
        return self.reading(i, bus_v)

    def ramp(self) -> None:
        """Set zero torque and wait for the current to decay."""
        axis = self.connected()
        if self.limits is None:
            return
        axis.hold(0.0, cmath.phase(self.target_a))
        self.target_a, zero_a = 0j, ZERO_CURRENT_RATIO * self.limits.current_a
        self.await_zero_current(
            lambda: axis.state() == CLOSED_LOOP and math.hypot(*axis.reading()[:2]) > zero_a, MAX_RAMP_S
        )
        time.sleep(CURRENT_DECAY_S)

    def switch_off(self) -> None:
        """Go idle and restore the board's settings."""
        axis = self.connected()
        if axis.state() == CLOSED_LOOP:
            self.ramp()
        axis.switch_off()

    def forget_fault(self) -> None:
        """Clear the board's errors; the axis stays idle."""
        self.connected().clear()

    def board_fault(self) -> DriveFault | None:
        """Fault by the axis' errors, or by leaving closed loop."""
        axis = self.connected()
        errors = axis.errors()
        if errors:
            return _fault(errors, self._options.watchdog_s)
        if axis.state() != CLOSED_LOOP:
            return DriveFault(FaultCause.INTERNAL, "the axis has left closed loop: another host controls it")
        return None


def _fault(errors: Errors, watchdog_s: float) -> DriveFault:
    if errors.axis & Errors.WATCHDOG:
        return DriveFault(FaultCause.HEARTBEAT_LOST, f"no heartbeat for {watchdog_s:g} s")
    return DriveFault(FaultCause.INTERNAL, f"ODrive errors: {errors}")
