"""The drive `xcp`: an ECU whose fast routine runs fluxbench's C file, by XCP on Ethernet.

Excitations are calibration parameters; rows are one DAQ list at the PWM event. docs/xcp.md states what the ECU needs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from orchestrator.driving.polled import PolledDrive
from plugins.drives.xcp._ecu import MAGIC, VERSION, Order, Rows, State, Status, Stream, fault_of
from plugins.drives.xcp._link import Link
from plugins.drives.xcp._program import Planner
from plugins.link import ProcessClock
from protocols import (
    Capabilities,
    Capture,
    CurrentControl,
    DriveFault,
    DriveRefused,
    DriveSetup,
    Excitation,
    ExcitationKind,
    FaultCause,
    GatesOff,
    Limits,
    Positive,
    Strict,
    Telemetry,
)

KINDS: frozenset[ExcitationKind] = frozenset({"gates_off", "hold", "trapezoid", "injection"})
POLL_PERIOD_S = 0.01
MIN_BLOCK_S = 0.1
"""Shortest block, except the last one."""
MAX_BLOCK_S = 0.25
"""Longest block, and longest time without one."""
STALL_TIMEOUT_S = 2.0
"""Time after a program's duration from which on missing rows are a fault."""


class XcpOptions(Strict):
    """Options of the drive `xcp`."""

    host: Annotated[str, Field(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 5555
    protocol: Literal["udp", "tcp"] = "udp"
    address: Annotated[int, Field(ge=0, lt=2**32)]
    """Address of the variable `fluxbench`: ECU_ADDRESS in the A2L, or from the linker's map."""
    address_extension: Annotated[int, Field(ge=0, le=255)] = 0
    event: Annotated[int, Field(ge=0, le=65535)] = 0
    """Number of the DAQ event behind the fast routine."""
    timeout_s: Positive = 2.0
    """Timeout for an answer of the ECU, and for the next row."""
    clear_fault: bool = False
    """Clear the ECU's latched fault on connecting; remove its cause first."""


class XcpDrive(PolledDrive[Link]):
    """An ECU as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `XcpOptions`.
    """

    name: ClassVar[str] = "xcp"
    Options: ClassVar[type[BaseModel]] = XcpOptions

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: XcpOptions = setup.options
        self._number, self._beat = 0, 0
        self._tick: int | None = None
        self._control = CurrentControl()

    # Link

    def open(self) -> Capabilities:
        """Find the variable `fluxbench` in the ECU and start its rows. Nothing is energised.

        Raises
        ------
        PluginError
            pyxcp is not installed.
        DriveFault
            No answer, or an unusable one.
        DriveRefused
            Another host controls the ECU, or its XCP lacks a required feature.
        InputError
            The nameplate lacks what current control is tuned by.
        """
        o = self._options
        self.board = link = Link(o.host, o.port, o.protocol, o.address, o.address_extension, o.timeout_s)
        link.open(o.event)
        facts = np.frombuffer(link.read(0, link.layout.facts.itemsize), link.layout.facts)[0]
        if (facts["magic"], facts["version"]) != (MAGIC, VERSION):
            message = f"{link.where}: no variable `fluxbench` {VERSION} at {o.address:#x}"
            raise DriveFault(FaultCause.WRONG_DATA, message)
        own = self._capabilities(facts)
        Planner(self.setup.motor, own.sampling_frequency_hz, own.max_current_a, own.max_voltage_v).to_zero(0.0)
        word = link.layout.word
        self._beat = int(np.frombuffer(link.read(link.layout.beat_at, word.itemsize), word)[0])
        self._number = Status.of(int(self._fresh_row()["status"])).number
        self._require_off(own)
        self.origin_s = self._count() / own.sampling_frequency_hz
        return own

    def _capabilities(self, facts: np.void) -> Capabilities:
        fs, watchdog_ticks = float(facts["sampling_hz"]), int(facts["watchdog_ticks"])
        try:
            return Capabilities(
                name="xcp",
                sampling_frequency_hz=fs,
                pwm_frequency_hz=float(facts["pwm_hz"]),
                pwm_frequencies_hz=(float(facts["pwm_hz"]),),
                dc_bus_voltage_v=float(facts["dc_bus_v"]),
                voltage_delay_samples=float(facts["delay_samples"]),
                max_current_a=float(facts["max_current_a"]),
                max_voltage_v=float(facts["max_voltage_v"]),
                excitations=KINDS,
                watchdog_s=watchdog_ticks / fs if watchdog_ticks else None,
                watchdog_covers=KINDS if watchdog_ticks else frozenset(),
            )
        except (ValueError, ZeroDivisionError) as error:
            message = f"the ECU states impossible capabilities: {str(error).splitlines()[0]}"
            raise DriveFault(FaultCause.WRONG_DATA, message) from None

    def _require_off(self, own: Capabilities) -> None:
        """Require the ECU to be off; clear a lost heartbeat, and other faults only where `clear_fault` is set."""
        status = Status.of(int(self._fresh_row()["status"]))
        if status.state == State.ON:
            raise DriveRefused("the ECU's power stage is on: another host controls it")
        if status.state == State.FAULTED:
            fault = fault_of(status)
            if fault.cause is FaultCause.HEARTBEAT_LOST or self._options.clear_fault:
                self._send_order(Order.CLEAR)
            else:
                self.latch(fault)

    def heartbeat(self) -> None:
        """Write the next heartbeat; after a failure the next call raises the lost link."""
        link = self.board
        if link is None or link.lost is not None or self._own is None:
            return
        self._beat = (self._beat + 1) % 2**32
        try:
            link.write(link.layout.beat_at, np.array(self._beat, link.layout.word).tobytes())
        except DriveFault:
            return  # the link keeps the fault

    # Power stage

    def check_link(self) -> None:
        """Raises `DriveFault` where the link is lost or the ECU has tripped."""
        if not self.latched:
            self._require_sound(Status.of(int(self._fresh_row()["status"])))

    def energise(self, limits: Limits) -> None:
        """Write the limits, read them back, and switch on at zero current."""
        self.heartbeat()
        self._run_order(Order.SWITCH_ON, self._planner(limits).to_zero(self.rotor_angle_rad))

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Write the program, read it back, start it and return its rows."""
        assert self.limits is not None
        planner = self._planner(self.limits)
        program = planner.program(excitation)
        if isinstance(excitation, GatesOff):
            self.ramp()
        number = self._run_order(Order.RUN, program)
        self.rotor_angle_rad, self._control = excitation.rotor_angle_rad, excitation.control
        return self._captures(excitation, number)

    def ramp(self) -> None:
        """Ramp the current to zero under control and wait for it."""
        assert self.limits is not None
        planner = self._planner(self.limits)
        self._run_order(Order.RUN, planner.to_zero(self.rotor_angle_rad, self._control))
        time.sleep(planner.ramp_s(self._control))

    def switch_off(self) -> None:
        """Gates off; raises `DriveFault` (still_armed) where they are not."""
        self._send_order(Order.SWITCH_OFF)
        status = Status.of(int(self._fresh_row()["status"]))
        if status.state == State.ON:
            raise DriveFault(FaultCause.STILL_ARMED, "the ECU does not switch off on command")
        if status.state == State.FAULTED:
            self.latch(fault_of(status))

    def forget_fault(self) -> None:
        """Clear the ECU's fault; its gates stay off."""
        self._send_order(Order.CLEAR)

    def telemetry(self) -> Telemetry:
        """The newest row."""
        row = self._fresh_row()
        status = Status.of(int(row["status"]))
        if status.state == State.FAULTED and not self.latched:
            self.trip(fault_of(status))
        i = complex(*row["i"]) * np.exp(-1j * self.rotor_angle_rad)
        return self.reading(i, float(row["v_dc"]), self.own.pwm_frequency_hz)

    # Clock

    def now_s(self) -> float:
        """Time since the experiment began, by the ECU's ticks."""
        return self._count() / self.own.sampling_frequency_hz - self.origin_s

    def restore(self, point_id: str, start_s: float) -> None:
        """Continue the experiment's clock from `start_s`."""
        self.origin_s += self.now_s() - start_s

    def _count(self, row: np.void | None = None) -> int:
        """Ticks since the link was opened, across overflows of the counter."""
        tick = int((self._fresh_row() if row is None else row)["tick"])
        self._tick = tick if self._tick is None else self._tick + _tick_difference(tick, self._tick)
        return self._tick

    # Programs

    def _captures(self, excitation: Excitation, number: int) -> Iterator[Capture]:
        """Blocks of captured rows; raises `DriveFault` for a trip, a gap, or missing rows."""
        link, fs = self.connected(), self.own.sampling_frequency_hz
        remaining, longest = excitation.rows(fs), round(MAX_BLOCK_S * fs)
        stream, pending = Stream(number), np.zeros(0, link.layout.row)
        yielded_s, waited_s = time.monotonic(), ProcessClock()
        timeout_s = STALL_TIMEOUT_S + 1.5 * (excitation.settling_s + excitation.captured_s)
        while remaining:
            pending = np.concatenate([pending, self._next_rows(stream)])
            while len(pending) >= min(remaining, MIN_BLOCK_S * fs) and remaining:
                yield self._capture(pending[:longest])
                remaining, pending = remaining - len(pending[:longest]), pending[longest:]
                yielded_s = time.monotonic()
            if time.monotonic() - yielded_s > MAX_BLOCK_S:
                yielded_s = time.monotonic()
                yield self.keepalive()
            if waited_s() > timeout_s:
                raise self.trip(DriveFault(FaultCause.PROGRAM_TOO_LONG, f"{excitation.kind}: its rows do not arrive"))

    def _next_rows(self, stream: Stream) -> Rows:
        """Newly captured rows; raises `DriveFault` where the ECU has tripped or rows are missing."""
        time.sleep(POLL_PERIOD_S)
        try:
            return stream.captured(self.connected().take())
        except DriveFault as fault:
            raise self.trip(fault) from None

    def _capture(self, rows: Rows) -> Capture:
        fs = self.own.sampling_frequency_hz
        i, v, v_dc = (rows[name].astype(np.float32) for name in ("i", "v", "v_dc"))
        start_s = self._count(rows[0]) / fs - self.origin_s
        return Capture(start_s=start_s, sampling_frequency_hz=fs, i_ab=i, v_ab=v, v_dc=v_dc)

    def _run_order(self, order: Order, program: dict[str, Any]) -> int:
        """Write a program, read it back and send the order; raises `DriveRefused` where the ECU refuses it."""
        link = self.connected()
        written = np.zeros((), link.layout.program)
        for name, value in program.items():
            written[name] = value
        link.write(link.layout.program_at, written.tobytes())
        readback = np.frombuffer(link.read(link.layout.program_at, written.nbytes), written.dtype)[0]
        for name in program:
            if not np.array_equal(readback[name], written[name]):
                message = f"{name} is {readback[name]} in the ECU after {written[name]} was written"
                raise self.trip(DriveFault(FaultCause.WRONG_DATA, message))
        return self._send_order(order)

    def _send_order(self, order: Order) -> int:
        """Send an order and wait until the routine has accepted it; returns its number."""
        link = self.connected()
        self._number = number = self._number % 0xFFFF + 1
        link.clear()
        link.write(link.layout.order_at, np.array(number << 16 | order, link.layout.word).tobytes())
        waited_s = ProcessClock()
        while (status := Status.of(int(self._fresh_row()["status"]))).number != number:
            if waited_s() > self._options.timeout_s:
                raise DriveFault(FaultCause.NO_ANSWER, f"the ECU's routine ignores the order {order.name.lower()}")
        if status.refused:
            self._require_sound(status)
            raise DriveRefused(f"the ECU's routine refuses to {order.name.lower().replace('_', ' ')}")
        return number

    # Helpers

    def _require_sound(self, status: Status) -> None:
        """Raises `DriveFault` where the ECU has tripped."""
        if status.state == State.FAULTED:
            raise self.trip(fault_of(status))

    def _planner(self, limits: Limits) -> Planner:
        return Planner(self.setup.motor, self.own.sampling_frequency_hz, limits.current_a, limits.voltage_v)

    def _fresh_row(self) -> np.void:
        return self.connected().newest()


def _tick_difference(tick: int, before: int) -> int:
    """Signed difference of two 32-bit counter values."""
    return (tick - before + 2**31) % 2**32 - 2**31
