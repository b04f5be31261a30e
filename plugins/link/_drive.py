"""A drive on any link: implements `protocols.Drive` by the drive protocol.

The drive runs programs and has its own protection and watchdog; this is the host's side.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from orchestrator.driving import DriveShell
from plugins.link._claims import ENERGISED, require_consistent_telemetry, require_memory
from plugins.link._errors import PROBE_HINT, link_errors
from plugins.link._host import Host, fault_names, known_fault, refused, require_readback, words
from plugins.link._link import Link
from plugins.link._machine import Machine, longest_capture, row_format
from plugins.link._port import Port, SharedPort
from plugins.link._running import Program
from plugins.link._timeline import CLOCK_KEY, SIMULATED_CLOCK, Timeline
from plugins.link._timeouts import TIMEOUTS
from plugins.wire import (
    NO_TEMPERATURE_C,
    TELEMETRY_PERIOD_S,
    AckStatus,
    Capability,
    EStop,
    Fault,
    Op,
    PowerState,
    Status,
    StopReason,
    capabilities_of,
    encode,
    facts_of,
    interlock_text,
    limit_registers,
    motor_registers,
    open_interlocks,
)
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    Limits,
    Positive,
    Strict,
    Telemetry,
)

DEMODULATED = "injections as ripple demodulated on the drive"


class LinkOptions(Strict):
    """Options of every drive on a link."""

    capture: Literal["raw", "demodulated"] = "raw"
    """Injections as raw samples, or as ripple demodulated on the drive, with 1 % of the data."""
    connect_timeout_s: Positive = 2.0
    """Longest wait for a drive that is starting, ramping down, or reported as armed by another host."""
    answer_timeout_s: Positive = 0.8
    """Time after which an unanswered request fails."""
    telemetry_period_s: Annotated[float, Field(ge=0.001, le=10.0)] = TELEMETRY_PERIOD_S
    """Period of the drive's status; silence for three of them is a lost link."""
    clear_fault: bool = False
    """Clear the drive's latched fault on connecting; remove its cause first."""


class LinkDrive(DriveShell):
    """Base class of a drive on a link; a subclass opens the port."""

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: LinkOptions = setup.options
        self._link: Link | None = None
        self._host: Host | None = None
        self._machine: Machine | None = None
        self._timeline: Timeline | None = None
        self._origin_s = 0.0
        self._number = 0

    @abstractmethod
    def open_port(self) -> Port:
        """Open the link; raises its library's errors."""

    # Link

    def open(self) -> Capabilities:
        """Open the link, identify the drive, and read its capabilities. Nothing is energised.

        A watchdog's fault is cleared, since its host is gone and this one was started on purpose. So
        is an interlock's fault, since an open interlock forbids arming anyway. Other faults are
        cleared only with the option `clear_fault`.

        Raises
        ------
        DriveFault
            No answer, a link that cannot be opened, or inconsistent registers.
        DriveRefused
            Armed by another host, another version, or a missing option.
        """
        with link_errors("the drive's link", PROBE_HINT):
            port = self.open_port()
        self._link = Link(port, self._options.telemetry_period_s)
        self._host = host = Host(self._link, self._options.answer_timeout_s)
        host.identify(self._options.connect_timeout_s)
        self._machine = self._read_machine(host)
        host.interlocks = self._machine.capabilities.interlocks
        cause = known_fault(host.read("fault_cause"))
        if cause in (Fault.WATCHDOG, Fault.INTERLOCK) or (cause is not Fault.NONE and self._options.clear_fault):
            self.forget_fault()
        else:
            host.fault_reported = cause is not Fault.NONE
        host.write({"telemetry_period_s": self._options.telemetry_period_s}, anew=True)
        host.link.news.faulted = host.link.news.status if host.fault_reported else None
        self._origin_s = 0.0
        self._origin_s = self._seconds(self._clock().now())
        return self._machine.capabilities

    def _read_machine(self, host: Host) -> Machine:
        own = host.own_registers()
        facts, layout = facts_of(own), host.link.port.layout(int(own["bulk_block_bytes"]))
        description = host.description(own, layout)
        demodulated = self._options.capture == "demodulated"
        if demodulated:
            if not facts.bits & Capability.RIPPLE_ON_DRIVE or not facts.ripple_memory_rows:
                raise DriveRefused("this drive demodulates no ripple; capture it raw")
            description = description | {"name": f"{description.get('name', 'drive')} ({DEMODULATED})"}
        machine = Machine(capabilities_of(own, description, None), facts, layout, demodulated)
        require_memory(facts, layout, row_format(machine).row_bytes)
        fs = machine.capabilities.sampling_frequency_hz
        is_simulated = description.get(CLOCK_KEY) == SIMULATED_CLOCK
        self._timeline = Timeline(host, fs, is_simulated)
        longest_s = longest_capture(machine, host.link.port.bulk_rate(layout))
        link_facts = {"longest_capture_s": longest_s, "clock_is_simulated": is_simulated}
        capabilities = machine.capabilities.model_copy(update=link_facts)
        return replace(machine, capabilities=capabilities)

    def release(self) -> None:
        """Close the link."""
        link, self._link, self._host, self._machine, self._timeline = self._link, None, None, None, None
        if link is not None:
            link.close()

    def heartbeat(self) -> None:
        """Send a heartbeat, unless the link is lost."""
        host = self._host
        if host is not None and host.link.lost is None:
            host.link.try_to_send(host.conversation.heartbeat(time.monotonic()))

    def heartbeat_outlet(self) -> int | None:
        """Descriptor of the port, if another process may write to it."""
        port = None if self._link is None else self._link.port
        return port.fileno() if isinstance(port, SharedPort) else None

    def heartbeat_at(self, time_s: float) -> bytes:
        """Bytes of the heartbeat at an instant; empty once the link is lost."""
        host = self._host
        if host is None or host.link.lost is not None or not isinstance(host.link.port, SharedPort):
            return b""
        return host.link.port.as_written([encode(host.conversation.heartbeat(time_s))])

    # Power stage

    @property
    def faults(self) -> tuple[str, ...]:
        """The drive's latched faults by its last status."""
        status = None if self._host is None else self._host.link.news.status
        return fault_names(status) if status is not None and status.state is PowerState.FAULTED else ()

    def check_link(self) -> None:
        """Raise `DriveFault` for a lost link, or for a fault that was not reported yet."""
        host, _ = self._connected()
        if self.faults and not host.fault_reported:
            raise host.fault()
        self._check_telemetry()

    def energise(self, limits: Limits) -> None:
        """Write nameplate and limits, read the limits back, and enable the power stage."""
        host, _ = self._connected()
        values = limit_registers(limits)
        host.write(motor_registers(self.setup.motor) | values, anew=True)
        for name, value in values.items():
            require_readback(name, value, host.read(name))
        ack = host.command(Op.ARM)
        if ack.status is AckStatus.INTERLOCK_OPEN:
            raise DriveRefused(interlock_text(ack.value, host.interlocks))
        if ack.status is not AckStatus.OK:
            raise refused(ack)
        host.conversation.armed(ack)
        self.heartbeat()
        self._await(host, (*ENERGISED, PowerState.FAULTED), TIMEOUTS.settle_s)

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Write and start the program; the iterator yields its rows."""
        host, machine = self._connected()
        try:
            program = Program(host, machine, excitation, self._clock(), self._check_telemetry)
        except DriveRefused as refusal:
            if host.command(Op.TIME_SYNC).state is PowerState.FAULTED:  # the fault occurred just now
                raise host.fault() from refusal
            raise
        if program.number == self._number:
            raise DriveFault(FaultCause.WRONG_DATA, f"two successive captures of the drive have number {self._number}")
        self._number = program.number
        return program.captures(self._seconds)

    def telemetry(self) -> Telemetry:
        """Present state by an acknowledgement, and the first measurement after it."""
        host, machine = self._connected()
        news, link = host.link.news, host.link
        readings = news.measurements
        now = self._clock().now()
        link.wait(lambda: news.measurements > readings + 1, 3.0 * self._options.telemetry_period_s)
        status, measurement = news.status, news.measurement
        if status is None or measurement is None:
            raise DriveFault(FaultCause.NO_ANSWER, "the drive sends no telemetry")
        scale, own = machine.facts.scales.current_a, machine.capabilities
        requested_hz = host.read("pwm_frequency_asked_hz") if len(own.pwm_frequencies_hz) > 1 else 0.0
        return Telemetry(
            state=_state_of(status),
            time_s=self._seconds(now),
            i_d_a=scale * measurement.i_d,
            i_q_a=scale * measurement.i_q,
            v_dc_v=measurement.v_dc,
            temperature_c=None if status.temperature == NO_TEMPERATURE_C else float(status.temperature),
            pwm_frequency_hz=requested_hz or own.pwm_frequency_hz,
            faults=fault_names(status),
            open_interlocks=open_interlocks(measurement.open_interlocks, own.interlocks),
        )

    def ramp(self) -> None:
        """Stop the program and wait for zero current."""
        host = self._reachable(Op.STOP)
        ack = host.command(Op.STOP)
        if ack.status is AckStatus.OK and ack.state in ENERGISED:
            self._await(host, (PowerState.HOLDING, PowerState.DISARMED, PowerState.FAULTED), TIMEOUTS.ramp_s)

    def switch_off(self) -> None:
        """Switch PWM off; sends an emergency stop to a drive that ignores it.

        Raises `DriveFault` (still_armed) in that case.
        """
        host = self._reachable(Op.STOP, Op.DISARM)
        ack = host.command(Op.DISARM)
        off = (PowerState.DISARMED, PowerState.FAULTED)
        if ack.state in off and self._reaches(host, off):
            return
        host.link.try_to_send(EStop(StopReason.HOST_ERROR))
        outcome = "only an emergency stop switched it off" if self._reaches(host, off) else "nor by an emergency stop"
        message = f"the drive does not disarm on command ({words(ack.status)}), {outcome}"
        raise DriveFault(FaultCause.STILL_ARMED, message)

    def forget_fault(self) -> None:
        """Clear the drive's latched faults; retried while it is ramping down."""
        host, _ = self._connected()
        deadline = time.monotonic() + self._options.connect_timeout_s
        while (ack := host.command(Op.CLEAR_FAULT)).status is not AckStatus.OK:
            if time.monotonic() > deadline:
                raise DriveRefused(f"the drive refuses to clear its fault: {words(ack.status)}")
            time.sleep(0.05)
        self._await(host, (PowerState.DISARMED, *ENERGISED), TIMEOUTS.settle_s)
        host.fault_reported, host.link.news.faulted = False, None

    def set_brake(self, engaged: bool) -> None:
        """Engage or release the brake; raises `DriveRefused` without one."""
        host, machine = self._connected()
        if not machine.capabilities.has_brake:
            super().set_brake(engaged)
        host.write({"brake": float(engaged)}, anew=True)

    # Clock

    def checkpoint(self, point_id: str) -> None:
        """Nothing to save: a real motor keeps its state."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Continue the experiment's clock from `start_s`."""
        self._connected()
        self._origin_s += self._seconds(self._clock().now()) - start_s

    def _clock(self) -> Timeline:
        self._connected()
        assert self._timeline is not None
        return self._timeline

    def _seconds(self, tick: int) -> float:
        assert self._machine is not None
        return tick / self._machine.capabilities.sampling_frequency_hz - self._origin_s

    # Helpers

    def _check_telemetry(self) -> None:
        host, machine = self._connected()
        limit_a = None if self.limits is None else self.limits.current_a
        require_consistent_telemetry(host.link.news, machine.facts.scales.current_a, limit_a)

    def _connected(self) -> tuple[Host, Machine]:
        """Host and drive; raises `DriveFault` where the link is lost, for good."""
        if self._host is None or self._machine is None:
            raise DriveRefused("not connected")
        self._host.link.check()
        return self._host, self._machine

    def _reachable(self, *orders: Op) -> Host:
        """The host for shutting down. A lost drive is sent the orders blindly, and the loss is raised."""
        if self._host is not None and self._host.link.lost is not None:
            for op in orders:
                self._host.link.try_to_send(self._host.conversation.command(op))
        return self._connected()[0]

    def _reaches(self, host: Host, states: tuple[PowerState, ...], timeout_s: float = TIMEOUTS.settle_s) -> bool:
        """Whether the drive reports one of the states in time."""
        news = host.link.news
        return host.link.wait(lambda: news.status is not None and news.status.state in states, timeout_s)

    def _await(self, host: Host, states: tuple[PowerState, ...], timeout_s: float) -> None:
        if not self._reaches(host, states, timeout_s):
            status = host.link.news.status
            now = "unknown" if status is None else status.state.name.lower()
            wanted = " or ".join(state.name.lower() for state in states)
            raise DriveFault(FaultCause.NO_ANSWER, f"the drive is {now} after {timeout_s:g} s instead of {wanted}")


def _state_of(status: Status) -> DriveState:
    if status.state is PowerState.FAULTED:
        return DriveState.FAULTED
    return DriveState.ARMED if status.state in ENERGISED else DriveState.DISARMED
