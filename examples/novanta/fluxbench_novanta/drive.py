"""The drive `novanta`: holds direct currents under the servo drive's own current control, in rows that it monitors.

It claims `hold` alone; the README says what keeps it from the rest.
"""

from __future__ import annotations

import cmath
import math
import time
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import BaseModel, Field

from fluxbench_novanta._servo import CURRENT_MODE, Servo
from orchestrator.driving.polled import PolledDrive
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
    InputError,
    Limits,
    Strict,
    Telemetry,
)

MAX_RAMP_S = 1.0
"""Time in which the current has to fall to zero."""
ZERO_CURRENT_RATIO = 0.03
"""Current over the drive's largest, below which it counts as zero."""
MAX_CURRENT_ERROR_RATIO = 0.2
"""Deviation from the set-point over the set-point, above which it is an error."""
MAX_MODULATION_RATIO = 0.9
"""Voltage over bus voltage, times the root of three, that the drive modulates."""
SET_POINTS = ("CL_CUR_D_SET_POINT", "CL_CUR_Q_SET_POINT")


class NovantaOptions(Strict):
    """Options of the drive `novanta`."""

    host: Annotated[str, Field(min_length=1)]
    port: Annotated[int, Field(ge=1, le=65535)] = 1061
    dictionary: Path
    """The drive's own, an .xdf file of its maker."""
    axis: Annotated[int, Field(ge=1, le=4)] = 1
    divider: Annotated[int, Field(ge=1, le=1000)] = 20
    """A row every so many periods of its control."""


class NovantaDrive(PolledDrive[Servo]):
    """A servo drive as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `NovantaOptions`.
    """

    name: ClassVar[str] = "novanta"
    Options: ClassVar[type[BaseModel]] = NovantaOptions
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {
        "gates_off": "what it measures of a current while it is off was not tried",
        "injection": "its disturbance of two voltages at once could not be tried (README)",
        "trapezoid": "its memory has some hundred rows",
    }

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: NovantaOptions = setup.options
        self._own_registers: dict[str, float] = {}

    # Link

    def open(self) -> Capabilities:
        """Connect, and read what the drive is. Nothing is energised.

        Raises `DriveFault` where nobody answers, `DriveRefused` where somebody else drives it or the nameplate does not
        fit, `InputError` where there is no dictionary.
        """
        o = self._options
        if not o.dictionary.is_file():
            raise InputError("drive", "dictionary", f"{o.dictionary} is no file")
        self.board = servo = Servo(o.host, o.port, o.dictionary, o.axis)
        if servo.state() == "ENABLED":
            raise DriveRefused(f"{servo.where}: its power stage is on: somebody else drives it")
        pole_pairs = int(servo.read("MOT_PAIR_POLES"))
        if pole_pairs != self.setup.motor.pole_pairs:
            message = f"MOT_PAIR_POLES is {pole_pairs}, the nameplate's pole pairs are {self.setup.motor.pole_pairs}"
            raise DriveRefused(f"{servo.where}: {message}")
        self._own_registers = {name: servo.read(name) for name in ("CL_CUR_REF_MAX", "DRV_OP_CMD")}
        fs, bus_v = servo.read("CL_CUR_FREQ") / o.divider, servo.read("DRV_PROT_VBUS_VALUE")
        self.origin_s = time.monotonic()
        pwm = servo.read("CL_CUR_FREQ")
        return Capabilities(
            name="novanta",
            sampling_frequency_hz=fs,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=(pwm,),
            dc_bus_voltage_v=bus_v,
            max_current_a=self._own_registers["CL_CUR_REF_MAX"],
            max_voltage_v=MAX_MODULATION_RATIO * bus_v / math.sqrt(3.0),
            longest_capture_s=servo.most_rows() / fs,
            heeds_bandwidth=False,
            excitations=frozenset(("hold",)),
            watchdog_s=None,
            notes=("no dead man is claimed; held currents alone",),
        )

    # Power stage

    def energise(self, limits: Limits) -> None:
        """Current mode at zero, within the run's current; then the power stage."""
        servo = self.connected()
        most = min(limits.current_a, self._own_registers["CL_CUR_REF_MAX"])
        try:
            servo.write({"CL_CUR_REF_MAX": most, "DRV_OP_CMD": CURRENT_MODE, **dict.fromkeys(SET_POINTS, 0.0)})
            servo.enable()
            self.require_sound(self.board_fault())
        except DriveFault as fault:
            raise self.trip(fault) from None

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Hold, window by window."""
        assert isinstance(excitation, Hold)
        return self.tripping(self._held(excitation))

    def _held(self, hold: Hold) -> Generator[Capture]:
        servo, fs = self.connected(), self.own.sampling_frequency_hz
        self.aim(hold)
        turn = cmath.exp(1j * servo.angle_rad())
        self._write_target(servo, turn)
        yield from self.waiting(hold.settle_s)
        count = hold.rows(fs)
        servo.monitor(count, self._options.divider)
        start_s, rows = time.monotonic(), None
        for rows in servo.monitored(count, count / fs):
            if rows is None:
                yield self.keepalive()
        assert rows is not None
        time.sleep(max(0.0, start_s + count / fs - time.monotonic()))
        self.require_sound(self.board_fault())
        i, v = ((rows[:, k] + 1j * rows[:, k + 1]) * turn for k in (0, 2))
        self._require_reached(complex(i.mean()))
        yield from self.blocks(i, v, start_s - self.origin_s, rows[:, 4])

    def _write_target(self, servo: Servo, turn: complex) -> None:
        aimed = self.target_a / turn
        servo.write(dict(zip(SET_POINTS, (aimed.real, aimed.imag), strict=True)))

    def _require_reached(self, i: complex) -> None:
        off, least = abs(i - self.target_a), ZERO_CURRENT_RATIO * self.own.max_current_a
        if off > max(MAX_CURRENT_ERROR_RATIO * abs(self.target_a), least):
            message = f"{abs(i):.3g} A flow, {off:.3g} A off the set-point of {abs(self.target_a):.3g} A"
            raise DriveFault(FaultCause.INTERNAL, f"{message}: the drive limits it, or the rotor has turned")

    def telemetry(self) -> Telemetry:
        """A reading, now; none of a current while the power stage is off."""
        servo = self.connected()
        on = servo.state() == "ENABLED"
        if self.limits is not None and not self.latched and (fault := self.board_fault()) is not None:
            self.trip(fault)
        i = 0j
        if on:
            own = complex(servo.read("CL_CUR_D_VALUE"), servo.read("CL_CUR_Q_VALUE"))
            i = own * cmath.exp(1j * (servo.angle_rad() - self.rotor_angle_rad))
        return self.reading(i, servo.read("DRV_PROT_VBUS_VALUE"))

    def ramp(self) -> None:
        """Set points of zero, and wait until the current is gone."""
        servo = self.connected()
        self.target_a = 0j
        self._write_target(servo, 1.0 + 0j)
        zero_a = ZERO_CURRENT_RATIO * self.own.max_current_a
        self.await_zero_current(
            lambda: (
                math.hypot(servo.read("CL_CUR_D_VALUE"), servo.read("CL_CUR_Q_VALUE")) > zero_a
                and servo.state() == "ENABLED"
            ),
            MAX_RAMP_S,
        )

    def switch_off(self) -> None:
        """Power stage off, and the drive's registers as they were."""
        servo = self.connected()
        if servo.state() == "ENABLED":
            self.ramp()
        servo.disable()
        own = self._own_registers
        servo.write({"CL_CUR_REF_MAX": own["CL_CUR_REF_MAX"], "DRV_OP_CMD": int(own["DRV_OP_CMD"])})

    def forget_fault(self) -> None:
        """Reset the drive's own fault; its power stage stays off."""
        servo = self.connected()
        if servo.state() == "FAULT":
            servo.forget_fault()

    def board_fault(self) -> DriveFault | None:
        """Its state and last error, where its power stage is off."""
        servo = self.connected()
        if (state := servo.state()) == "ENABLED":
            return None
        code = int(servo.read("DRV_DIAG_ERROR_LAST"))
        return DriveFault(FaultCause.INTERNAL, f"{servo.where} is in state {state}, its last error is {code:#x}")
