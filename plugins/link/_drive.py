"""A drive at the other end of a link: the contract of `protocols.Drive`, whatever the link.

The drive runs programs, protects itself, and has a watchdog; here is what a host does with it.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from orchestrator.driving import DriveShell
from plugins.link._claims import ENERGISED, require_memory, require_sound
from plugins.link._errors import PROBE_HINT, link_errors
from plugins.link._host import Host, fault_names, known_fault, refused, require_held, words
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
    """Options of every drive behind a link."""

    capture: Literal["raw", "demodulated"] = "raw"
    """Injections sample by sample, or as ripple demodulated on the drive: a hundredth of the data."""
    connect_timeout_s: Positive = 2.0
    """Time to be taken up by a drive that is starting, that another host seems to have armed, or that ramps down."""
    answer_timeout_s: Positive = 0.8
    """A request that is not answered within this time is given up."""
    telemetry_period_s: Annotated[float, Field(ge=0.001, le=10.0)] = TELEMETRY_PERIOD_S
    """Period of the drive's status; silence for three of them is a lost link."""
    clear_fault: bool = False
    """Forget the fault that the drive has latched, on connecting: after somebody has seen to its cause."""


class LinkDrive(DriveShell):
    """Everything but the port itself, which `open_port` makes."""

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
        """Open the link; errors of its library may pass."""

    # Link

    def open(self) -> Capabilities:
        """Open the link, identify the drive, and read what it can do. Nothing is energised.

        A watchdog's fault is cleared: its host is gone, and somebody has started this one. So is an
        interlock's, which forbids arming for as long as it is open. Other faults stay, unless the
        option `clear_fault` says that they have been seen to.

        Raises
        ------
        DriveFault
            Nobody answers, the link cannot be opened, or what is read describes no drive.
        DriveRefused
            Another host has the drive armed, it speaks another version, or lacks an option.
        """
        with link_errors("the drive's link", PROBE_HINT):
            port = self.open_port()
        self._link = Link(port, self._options.telemetry_period_s)
        self._host = host = Host(self._link, self._options.answer_timeout_s)
        host.identify(self._options.connect_timeout_s)
        self._machine = self._learned(host)
        host.interlocks = self._machine.capabilities.interlocks
        cause = known_fault(host.read("fault_cause"))
        if cause in (Fault.WATCHDOG, Fault.INTERLOCK) or (cause is not Fault.NONE and self._options.clear_fault):
            self.forget_fault()
        else:
            host.fault_reported = cause is not Fault.NONE
        host.write({"telemetry_period_s": self._options.telemetry_period_s}, anew=True)
        self._origin_s = 0.0
        self._origin_s = self._seconds(self._clock().now())
        return self._machine.capabilities

    def _learned(self, host: Host) -> Machine:
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
        learned = {"longest_capture_s": longest_s, "clock_is_simulated": is_simulated}
        capabilities = machine.capabilities.model_copy(update=learned)
        return replace(machine, capabilities=capabilities)

    def release(self) -> None:
        """Let go of the link."""
        link, self._link, self._host, self._machine, self._timeline = self._link, None, None, None, None
        if link is not None:
            link.close()

    def heartbeat(self) -> None:
        """Send that the host is alive; nothing once the link is lost."""
        host = self._host
        if host is not None and host.link.lost is None:
            host.link.try_to_send(host.conversation.heartbeat(time.monotonic()))

    def heartbeat_outlet(self) -> int | None:
        """The port's descriptor, where another process may write to it."""
        port = None if self._link is None else self._link.port
        return port.fileno() if isinstance(port, SharedPort) else None

    def heartbeat_at(self, time_s: float) -> bytes:
        """The heartbeat of that instant; nothing once the link is lost."""
        host = self._host
        if host is None or host.link.lost is not None or not isinstance(host.link.port, SharedPort):
            return b""
        return host.link.port.as_written([encode(host.conversation.heartbeat(time_s))])

    # Power stage

    @property
    def faults(self) -> tuple[str, ...]:
        """What the drive has latched, by its last status."""
        status = None if self._host is None else self._host.link.news.status
        return fault_names(status) if status is not None and status.state is PowerState.FAULTED else ()

    def check_link(self) -> None:
        """Raise the link's loss, or a fault that was not reported yet."""
        host, _ = self._connected()
        if self.faults and not host.fault_reported:
            raise host.fault()
        self._require_sound()

    def energise(self, limits: Limits) -> None:
        """Hand over nameplate and limits, read the limits back, and enable the power stage."""
        host, _ = self._connected()
        values = limit_registers(limits)
        host.write(motor_registers(self.setup.motor) | values, anew=True)
        for name, value in values.items():
            require_held(name, value, host.read(name))
        ack = host.command(Op.ARM)
        if ack.status is AckStatus.INTERLOCK_OPEN:
            raise DriveRefused(interlock_text(ack.value, host.interlocks))
        if ack.status is not AckStatus.OK:
            raise refused(ack)
        host.conversation.armed(ack)
        self.heartbeat()
        self._await(host, (*ENERGISED, PowerState.FAULTED), TIMEOUTS.settle_s)

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Write the program and start it; its rows come as the iterator is drawn from."""
        host, machine = self._connected()
        try:
            program = Program(host, machine, excitation, self._clock(), self._require_sound)
        except DriveRefused as refusal:
            if host.command(Op.TIME_SYNC).state is PowerState.FAULTED:  # it came in that moment
                raise host.fault() from refusal
            raise
        if program.number == self._number:
            raise DriveFault(FaultCause.WRONG_DATA, f"the drive gives two captures in a row the number {self._number}")
        self._number = program.number
        return program.captures(self._seconds)

    def telemetry(self) -> Telemetry:
        """State by an acknowledgement of now, current by the first reading after it."""
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
        """Stop what runs, and wait until the current is zero."""
        host = self._reachable(Op.STOP)
        ack = host.command(Op.STOP)
        if ack.status is AckStatus.OK and ack.state in ENERGISED:
            self._await(host, (PowerState.HOLDING, PowerState.DISARMED, PowerState.FAULTED), TIMEOUTS.ramp_s)

    def switch_off(self) -> None:
        """PWM off; a drive that ignores it gets an emergency stop, and the error says so.

        Raises `DriveFault`: still_armed.
        """
        host = self._reachable(Op.STOP, Op.DISARM)
        ack = host.command(Op.DISARM)
        off = (PowerState.DISARMED, PowerState.FAULTED)
        if ack.state in off and self._gets_to(host, off):
            return
        host.link.try_to_send(EStop(StopReason.HOST_ERROR))
        what_then = "only an emergency stop switched it off" if self._gets_to(host, off) else "nor by an emergency stop"
        message = f"the drive does not disarm on command ({words(ack.status)}), {what_then}"
        raise DriveFault(FaultCause.STILL_ARMED, message)

    def forget_fault(self) -> None:
        """Clear the drive's latched faults; repeated while it is still ramping down."""
        host, _ = self._connected()
        deadline = time.monotonic() + self._options.connect_timeout_s
        while (ack := host.command(Op.CLEAR_FAULT)).status is not AckStatus.OK:
            if time.monotonic() > deadline:
                raise DriveRefused(f"the drive refuses to clear its fault: {words(ack.status)}")
            time.sleep(0.05)
        self._await(host, (PowerState.DISARMED, *ENERGISED), TIMEOUTS.settle_s)
        host.fault_reported = False

    def set_brake(self, engaged: bool) -> None:
        """Move the brake, where there is one."""
        host, machine = self._connected()
        if not machine.capabilities.has_brake:
            super().set_brake(engaged)
        host.write({"brake": float(engaged)}, anew=True)

    # Clock

    def checkpoint(self, point_id: str) -> None:
        """Nothing to keep: the machine remembers by itself."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        self._connected()
        self._origin_s += self._seconds(self._clock().now()) - start_s

    def _clock(self) -> Timeline:
        self._connected()
        assert self._timeline is not None
        return self._timeline

    def _seconds(self, tick: int) -> float:
        assert self._machine is not None
        return tick / self._machine.capabilities.sampling_frequency_hz - self._origin_s

    # What the methods share

    def _require_sound(self) -> None:
        host, machine = self._connected()
        news, limit_a = host.link.news, None if self.limits is None else self.limits.current_a
        require_sound(news.status, news.measurement, machine.facts.scales.current_a, limit_a)

    def _connected(self) -> tuple[Host, Machine]:
        """Raises `DriveFault` where the link is lost; once lost, nothing is armed again."""
        if self._host is None or self._machine is None:
            raise DriveRefused("not connected")
        self._host.link.check()
        return self._host, self._machine

    def _reachable(self, *last_words: Op) -> Host:
        """The host for shutting down. A lost drive gets the commands all the same, and the reason is raised."""
        if self._host is not None and self._host.link.lost is not None:
            for op in last_words:
                self._host.link.try_to_send(self._host.conversation.command(op))
        return self._connected()[0]

    def _gets_to(self, host: Host, states: tuple[PowerState, ...], timeout_s: float = TIMEOUTS.settle_s) -> bool:
        """Whether the drive's status says so in time."""
        news = host.link.news
        return host.link.wait(lambda: news.status is not None and news.status.state in states, timeout_s)

    def _await(self, host: Host, states: tuple[PowerState, ...], timeout_s: float) -> None:
        if not self._gets_to(host, states, timeout_s):
            status = host.link.news.status
            now = "unknown" if status is None else status.state.name.lower()
            wanted = " or ".join(state.name.lower() for state in states)
            raise DriveFault(FaultCause.NO_ANSWER, f"the drive is {now} after {timeout_s:g} s instead of {wanted}")


def _state_of(status: Status) -> DriveState:
    if status.state is PowerState.FAULTED:
        return DriveState.FAULTED
    return DriveState.ARMED if status.state in ENERGISED else DriveState.DISARMED
