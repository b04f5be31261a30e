"""A drive at the other end of a link: the contract of `protocols.Drive`, whatever the link.

The drive runs programs, protects itself, and has a watchdog; here is what a host does with it.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace

from plugins.link._errors import link_errors
from plugins.link._host import Host, fault_names, known_fault, require_held, words
from plugins.link._link import Link
from plugins.link._machine import Machine
from plugins.link._options import LinkOptions
from plugins.link._port import Port
from plugins.link._running import Program
from plugins.wire import (
    Ack,
    AckStatus,
    Capability,
    CaptureFormat,
    Fault,
    Op,
    PowerState,
    RowFormat,
    Status,
    Unwrapped,
    capabilities_of,
    facts_of,
    limit_registers,
    motor_registers,
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
    Telemetry,
)

RAMP_S = 8.0
"""A current that is not zero after so long is not ramping down."""
SETTLE_S = 1.0
"""A change of state that does not show in the status after so long has not happened."""
DEMODULATED = "injections as ripple demodulated on the drive"
_ENERGISED = (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)
_NO_TEMPERATURE_C = -128


class LinkDrive(ABC):
    """Everything but the link itself, which `_open` makes."""

    def __init__(self, setup: DriveSetup) -> None:
        self._setup = setup
        self._options: LinkOptions = setup.options
        self._link: Link | None = None
        self._host: Host | None = None
        self._machine: Machine | None = None
        self._unwrapped = Unwrapped()
        self._origin_s = 0.0
        self._turn = 0

    @abstractmethod
    def _open(self) -> Port:
        """Open the link; errors of its library may pass."""

    # Link

    def connect(self) -> Capabilities:
        """Open the link, identify the drive, and read what it can do. Nothing is energised.

        A watchdog's fault is cleared: its host is gone, and somebody has started this one. Other
        faults stay, unless the option `clear_fault` says that they have been seen to.

        Raises
        ------
        DriveFault
            Nobody answers, the link cannot be opened, or what is read describes no drive.
        DriveRefused
            Another host has the drive armed, it speaks another version, or lacks what was asked for.
        """
        with link_errors("the drive's link"):
            port = self._open()
        self._link = Link(port, self._options.telemetry_period_s)
        self._host = host = Host(self._link, self._options.answer_timeout_s)
        host.identify(self._options.connect_timeout_s)
        self._machine = self._learned(host)
        self._clear_what_is_over(host)
        host.write({"telemetry_period_s": self._options.telemetry_period_s}, anew=True)
        self._origin_s = 0.0
        self._origin_s = self._seconds(host.tick().tick)
        return self._machine.capabilities

    def _learned(self, host: Host) -> Machine:
        own = host.own_registers()
        facts, layout = facts_of(own), host.link.layout(int(own["bulk_block_bytes"]))
        description = host.description(own, layout)
        demodulated = self._options.capture == "demodulated"
        if demodulated:
            if not facts.bits & Capability.RIPPLE_ON_DRIVE or not facts.ripple_memory_rows:
                raise DriveRefused("this drive demodulates no ripple; capture it raw")
            description = description | {"name": f"{description.get('name', 'drive')} ({DEMODULATED})"}
        machine = Machine(capabilities_of(own, description, None), facts, layout, demodulated)
        longest_s = longest_capture(machine, host.link.port.bulk_rate(layout))
        capabilities = machine.capabilities.model_copy(update={"longest_capture_s": longest_s})
        return replace(machine, capabilities=capabilities)

    def _clear_what_is_over(self, host: Host) -> None:
        cause = known_fault(host.read("fault_cause"))
        if cause is Fault.WATCHDOG or (cause is not Fault.NONE and self._options.clear_fault):
            self.clear_fault()
        else:
            host.fault_told = cause is not Fault.NONE

    def close(self) -> None:
        """Let go of the link."""
        self._turn += 1
        link, self._link, self._host, self._machine = self._link, None, None, None
        if link is not None:
            link.close()

    def heartbeat(self) -> None:
        """Say that the host is alive; nothing more is said once the link is lost."""
        host = self._host
        if host is not None and host.link.lost is None:
            host.link.try_to_send(host.conversation.heartbeat(time.monotonic()))

    # Power stage

    def arm(self, limits: Limits) -> None:
        """Hand over nameplate and limits, read the limits back, and enable the power stage."""
        host, machine = self._connected()
        own = machine.capabilities
        for name, wanted, most in (
            ("current", limits.current_a, own.max_current_a),
            ("voltage", limits.voltage_v, own.max_voltage_v),
        ):
            if wanted > most * (1.0 + 1e-6):
                raise DriveRefused(f"{name} limit {wanted:g} is above the drive's own {most:g}")
        self._refuse_latched(host)
        values = limit_registers(limits)
        host.write(motor_registers(self._setup.motor) | values, anew=True)
        for name, value in values.items():
            require_held(name, value, host.read(name))
        ack = host.do(Op.ARM)
        host.conversation.armed(ack)
        self.heartbeat()
        self._await(host, (*_ENERGISED, PowerState.FAULTED), SETTLE_S)

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        """Write the program and start it; its rows come as the iterator is drawn from."""
        host, machine = self._connected()
        status = host.link.news.status
        if status is not None and status.state is PowerState.FAULTED:
            raise host.fault()
        _refuse_unclaimed(excitation, machine.capabilities)
        self._turn += 1
        try:
            program = Program(host, machine, excitation)
        except DriveRefused:
            self._raise_fault_behind(host)
            raise
        return self._captures(program, self._turn)

    def _captures(self, program: Program, turn: int) -> Iterator[Capture]:
        for capture in program.captures(self._seconds):
            if self._turn != turn:
                raise DriveRefused("the excitation was given up")
            yield capture

    def telemetry(self) -> Telemetry:
        """State by an acknowledgement of now, current by the first reading after it."""
        host, machine = self._connected()
        news, link = host.link.news, host.link
        readings = news.measurements
        tick = host.tick()
        link.wait(lambda: news.measurements > readings + 1, 3.0 * self._options.telemetry_period_s)
        status, measurement = news.status, news.measurement
        if status is None or measurement is None:
            raise DriveFault(FaultCause.NO_ANSWER, "the drive sends no telemetry")
        scale = machine.facts.scales.current_a
        return Telemetry(
            state=_state_of(status),
            time_s=self._seconds(tick.tick),
            i_d_a=scale * measurement.i_d,
            i_q_a=scale * measurement.i_q,
            v_dc_v=measurement.v_dc,
            temperature_c=None if status.temperature == _NO_TEMPERATURE_C else float(status.temperature),
            faults=fault_names(status),
        )

    def ramp_down(self) -> None:
        """Stop what runs, and wait until the current is zero; where PWM is off there is nothing to do."""
        self._turn += 1
        host = self._reachable(Op.STOP)
        if host is None:
            return
        ack = host.command(Op.STOP)
        if ack.status is AckStatus.OK and ack.state in _ENERGISED:
            self._await(host, (PowerState.HOLDING, PowerState.DISARMED, PowerState.FAULTED), RAMP_S)

    def disarm(self) -> None:
        """PWM off."""
        self._turn += 1
        host = self._reachable(Op.STOP, Op.DISARM)
        if host is None:
            return
        ack = host.command(Op.DISARM)
        if ack.state in _ENERGISED:
            raise DriveFault(FaultCause.INTERNAL, f"the drive does not disarm: {words(ack.status)}")
        self._await(host, (PowerState.DISARMED, PowerState.FAULTED), SETTLE_S)

    def clear_fault(self) -> None:
        """Forget latched faults; a drive that is still ramping down is asked again."""
        host, _ = self._connected()
        deadline = time.monotonic() + self._options.connect_timeout_s
        while (ack := host.command(Op.CLEAR_FAULT)).status is not AckStatus.OK:
            if time.monotonic() > deadline:
                raise DriveRefused(f"the drive refuses to clear its fault: {words(ack.status)}")
            time.sleep(0.05)
        self._await(host, (PowerState.DISARMED, *_ENERGISED), SETTLE_S)
        host.fault_told = False

    def set_brake(self, engaged: bool) -> None:
        """Move the brake, where there is one."""
        host, machine = self._connected()
        if not machine.capabilities.has_brake:
            raise DriveRefused("this drive has no brake to move")
        host.write({"brake": float(engaged)}, anew=True)

    # Clock

    def checkpoint(self, point_id: str) -> None:  # noqa: B027 - nothing to do is the answer, not a gap
        """Nothing to keep: the machine remembers by itself."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        host, _ = self._connected()
        self._origin_s += self._seconds(host.tick().tick) - start_s

    def _seconds(self, tick: int) -> float:
        assert self._machine is not None
        return self._unwrapped(tick) / self._machine.capabilities.sampling_frequency_hz - self._origin_s

    # What the methods share

    def _connected(self) -> tuple[Host, Machine]:
        """Raises `DriveFault` where the link is lost; once lost, nothing is armed again."""
        if self._host is None or self._machine is None:
            raise DriveRefused("not connected")
        self._host.link.check()
        return self._host, self._machine

    def _reachable(self, *last_words: Op) -> Host | None:
        """The host for a way out: None where there never was a link.

        On a dead one the drive is told all the same, for it may still hear, and the reason is raised.
        """
        host = self._host
        if host is None:
            return None
        if host.link.lost is not None:
            host.shout(*last_words)
            host.link.check()
        return host

    def _await(self, host: Host, states: tuple[PowerState, ...], timeout_s: float) -> None:
        news = host.link.news

        def there() -> bool:
            return news.status is not None and news.status.state in states

        if not host.link.wait(there, timeout_s):
            now = "unknown" if news.status is None else news.status.state.name.lower()
            wanted = " or ".join(state.name.lower() for state in states)
            raise DriveFault(FaultCause.NO_ANSWER, f"the drive is {now} after {timeout_s:g} s instead of {wanted}")

    def _refuse_latched(self, host: Host) -> None:
        """A fault that nobody has heard of yet is told as what it is; after that, arming is refused."""
        status = host.link.news.status
        if status is not None and status.state is PowerState.FAULTED:
            if not host.fault_told:
                raise host.fault()
            raise DriveRefused(f"a fault is latched ({', '.join(fault_names(status))}); clear it first")

    def _raise_fault_behind(self, host: Host) -> None:
        """Where a refusal has a fault behind it that came in that moment, the fault is the better news."""
        ack: Ack = host.command(Op.TIME_SYNC)
        if ack.state is PowerState.FAULTED:
            raise host.fault()


def longest_capture(machine: Machine, bulk_rate: float | None) -> float | None:
    """Longest raw capture that memory and line allow together [s]; None where nothing limits it.

    A ring is read while it fills, so that only what the line is behind has to fit.
    """
    row_bytes = RowFormat(machine.channels, CaptureFormat.INT16, machine.facts.scales).row_bytes
    row_rate = machine.capabilities.sampling_frequency_hz * row_bytes
    if machine.facts.bits & Capability.CAPTURE_RING:
        if bulk_rate is None or bulk_rate > row_rate:
            return None
        row_rate -= bulk_rate
    return machine.facts.memory_bytes / row_rate


def _refuse_unclaimed(excitation: Excitation, own: Capabilities) -> None:
    if excitation.kind not in own.excitations:
        raise DriveRefused(f"this drive has no {excitation.kind}")
    asked = excitation.pwm_frequency_hz
    if asked is not None and not any(abs(asked - f) <= 1e-6 * f for f in own.pwm_frequencies_hz):
        choices = ", ".join(f"{f:g}" for f in own.pwm_frequencies_hz)
        raise DriveRefused(f"PWM frequency {asked:g} Hz; this drive has {choices} Hz")


def _state_of(status: Status) -> DriveState:
    if status.state is PowerState.FAULTED:
        return DriveState.FAULTED
    return DriveState.ARMED if status.state in _ENERGISED else DriveState.DISARMED
