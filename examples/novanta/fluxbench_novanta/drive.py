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

import numpy as np
from pydantic import BaseModel, Field

from fluxbench_novanta._servo import CURRENT_MODE, Servo
from orchestrator.driving import DriveShell, in_blocks, keepalive
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

ALIVE_S, RAMP_S, ZERO, OFF, MODULATED = 0.2, 1.0, 0.03, 0.2, 0.9
"""Parts: of the run's current, what is none; of a current, how far it may be off; of the bus, what is modulated."""
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


class NovantaDrive(DriveShell):
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
        self._servo: Servo | None = None
        self._own_registers: dict[str, float] = {}
        self._target, self._rotor_angle_rad, self._origin_s = 0j, 0.0, 0.0

    # Link

    def open(self) -> Capabilities:
        """Connect, and read what the drive is. Nothing is energised.

        Raises `DriveFault` where nobody answers, `DriveRefused` where somebody else drives it or the nameplate does not
        fit, `InputError` where there is no dictionary.
        """
        o = self._options
        if not o.dictionary.is_file():
            raise InputError("drive", "dictionary", f"{o.dictionary} is no file")
        self._servo = servo = Servo(o.host, o.port, o.dictionary, o.axis)
        if servo.state() == "ENABLED":
            raise DriveRefused(f"{servo.where}: its power stage is on: somebody else drives it")
        pole_pairs = int(servo.read("MOT_PAIR_POLES"))
        if pole_pairs != self.setup.motor.pole_pairs:
            told = f"MOT_PAIR_POLES is {pole_pairs}, the nameplate's pole pairs are {self.setup.motor.pole_pairs}"
            raise DriveRefused(f"{servo.where}: {told}")
        self._own_registers = {name: servo.read(name) for name in ("CL_CUR_REF_MAX", "DRV_OP_CMD")}
        fs, bus_v = servo.read("CL_CUR_FREQ") / o.divider, servo.read("DRV_PROT_VBUS_VALUE")
        self._origin_s = time.monotonic()
        pwm = servo.read("CL_CUR_FREQ")
        return Capabilities(
            name="novanta",
            sampling_frequency_hz=fs,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=(pwm,),
            dc_bus_voltage_v=bus_v,
            max_current_a=self._own_registers["CL_CUR_REF_MAX"],
            max_voltage_v=MODULATED * bus_v / math.sqrt(3.0),
            longest_capture_s=servo.most_rows() / fs,
            heeds_bandwidth=False,
            excitations=frozenset(("hold",)),
            watchdog_s=None,
            notes=("no dead man is claimed; held currents alone",),
        )

    def release(self) -> None:
        """Let go of the network."""
        servo, self._servo = self._servo, None
        if servo is not None:
            servo.close()

    # Power stage

    @property
    def faults(self) -> tuple[str, ...]:
        return tuple(f"{fault.cause.value}: {fault.detail}" for fault in self.latched)

    def check_link(self) -> None:
        """Raises `DriveFault` where the drive has tripped or cannot be reached."""
        servo = self._connected()
        if self.limits is not None and not self.latched:
            self._require_sound(servo)

    def energise(self, limits: Limits) -> None:
        """Current mode at zero, within the run's current; then the power stage."""
        servo = self._connected()
        most = min(limits.current_a, self._own_registers["CL_CUR_REF_MAX"])
        try:
            servo.write({"CL_CUR_REF_MAX": most, "DRV_OP_CMD": CURRENT_MODE, **dict.fromkeys(SET_POINTS, 0.0)})
            servo.enable()
            self._require_sound(servo)
        except DriveFault as fault:
            raise self.trip(fault) from None

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Hold, window by window."""
        assert isinstance(excitation, Hold)
        return self._held(excitation)

    def _held(self, hold: Hold) -> Generator[Capture]:
        servo, fs = self._connected(), self.own.sampling_frequency_hz
        self._rotor_angle_rad = hold.rotor_angle_rad
        self._target = complex(*hold.start_dq_a) * cmath.exp(1j * hold.rotor_angle_rad)
        try:
            turn = cmath.exp(1j * servo.angle_rad())
            self._aim(servo, turn)
            until_s = time.monotonic() + hold.settle_s
            while (left_s := until_s - time.monotonic()) > 0.0:
                time.sleep(min(left_s, ALIVE_S))
                yield self._alive()
            count = hold.rows(fs)
            servo.monitor(count, self._options.divider)
            start_s, rows = time.monotonic(), None
            for rows in servo.monitored(count, count / fs):
                if rows is None:
                    yield self._alive()
            assert rows is not None
            time.sleep(max(0.0, start_s + count / fs - time.monotonic()))
            self._require_sound(servo)
            i, v = ((rows[:, k] + 1j * rows[:, k + 1]) * turn for k in (0, 2))
            self._require_reached(complex(i.mean()))
        except DriveFault as fault:
            raise self.trip(fault) from None
        arrays = {name: np.stack([x.real, x.imag], axis=1).astype(np.float32) for name, x in (("i_ab", i), ("v_ab", v))}
        bus = rows[:, 4].astype(np.float32)
        yield from in_blocks(Capture(start_s=start_s - self._origin_s, sampling_frequency_hz=fs, v_dc=bus, **arrays))

    def _aim(self, servo: Servo, turn: complex) -> None:
        aimed = self._target / turn
        servo.write(dict(zip(SET_POINTS, (aimed.real, aimed.imag), strict=True)))

    def _require_reached(self, i: complex) -> None:
        off, least = abs(i - self._target), ZERO * self.own.max_current_a
        if off > max(OFF * abs(self._target), least):
            told = f"{abs(i):.3g} A flow, {off:.3g} A off the {abs(self._target):.3g} A asked for"
            raise DriveFault(FaultCause.INTERNAL, f"{told}: the drive limits it, or the rotor has turned")

    def telemetry(self) -> Telemetry:
        """A reading, now; none of a current while the power stage is off."""
        servo = self._connected()
        on = servo.state() == "ENABLED"
        if self.limits is not None and not self.latched and not on:
            self.trip(self._fault(servo))
        i = 0j
        if on:
            own = complex(servo.read("CL_CUR_D_VALUE"), servo.read("CL_CUR_Q_VALUE"))
            i = own * cmath.exp(1j * (servo.angle_rad() - self._rotor_angle_rad))
        return Telemetry(
            state=self.state,
            time_s=time.monotonic() - self._origin_s,
            i_d_a=i.real,
            i_q_a=i.imag,
            v_dc_v=servo.read("DRV_PROT_VBUS_VALUE"),
            faults=self.faults,
        )

    def ramp(self) -> None:
        """Set points of zero, and wait until the current is gone."""
        servo = self._connected()
        self._target = 0j
        self._aim(servo, 1.0 + 0j)
        deadline = time.monotonic() + RAMP_S
        while math.hypot(servo.read("CL_CUR_D_VALUE"), servo.read("CL_CUR_Q_VALUE")) > ZERO * self.own.max_current_a:
            if servo.state() != "ENABLED":
                return
            if time.monotonic() > deadline:
                raise DriveFault(FaultCause.NO_ANSWER, f"a current still flows after {RAMP_S:g} s of ramping down")

    def switch_off(self) -> None:
        """Power stage off, and the drive's registers as they were."""
        servo = self._connected()
        if servo.state() == "ENABLED":
            self.ramp()
        servo.disable()
        servo.write(self._as_they_were())

    def _as_they_were(self) -> dict[str, float]:
        own = self._own_registers
        return {"CL_CUR_REF_MAX": own["CL_CUR_REF_MAX"], "DRV_OP_CMD": int(own["DRV_OP_CMD"])}

    def forget_fault(self) -> None:
        """Reset the drive's own fault; its power stage stays off."""
        servo = self._connected()
        if servo.state() == "FAULT":
            servo.forget_fault()

    def _fault(self, servo: Servo) -> DriveFault:
        state, code = servo.state(), int(servo.read("DRV_DIAG_ERROR_LAST"))
        return DriveFault(FaultCause.INTERNAL, f"{servo.where} is in state {state}, its last error is {code:#x}")

    def _require_sound(self, servo: Servo) -> None:
        if servo.state() != "ENABLED":
            raise self.trip(self._fault(servo))

    # Clock

    def checkpoint(self, point_id: str) -> None:
        """Nothing to keep: the motor remembers by itself."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        self._origin_s = time.monotonic() - start_s

    # What the methods share

    def _alive(self) -> Capture:
        return keepalive(time.monotonic() - self._origin_s, self.own.sampling_frequency_hz)

    def _connected(self) -> Servo:
        if self._servo is None:
            raise DriveRefused("not connected")
        return self._servo
