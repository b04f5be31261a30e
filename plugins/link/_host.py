"""The host's requests: stop-and-wait commands, registers by name, description and faults of the drive."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from plugins.link._link import Link
from plugins.link._reading import read_whole
from plugins.link._timeouts import TIMEOUTS
from plugins.wire import (
    DESCRIPTION_CAPTURE,
    PROTOCOL_MAJOR,
    Ack,
    AckStatus,
    BlockLayout,
    Command,
    Conversation,
    Fault,
    Op,
    ParameterRead,
    ParameterValue,
    ParameterWrite,
    Status,
    Tick,
    answers,
    drive_fault,
    parse_description,
    register_index,
    registers,
    single,
)
from protocols import DriveFault, DriveRefused, FaultCause, InputError

_FAULT_REGISTERS = ("fault_cause", "fault_value", "fault_limit", "fault_bits")


class Host:
    """Requests of one host to one drive, by a link; for one thread.

    Parameters
    ----------
    link : Link
    answer_s : float
        Time after which an unanswered request fails.
    """

    def __init__(self, link: Link, answer_s: float) -> None:
        self.link = link
        self.conversation = Conversation()
        self.next_window = 0
        self._answer_s = answer_s
        self.fault_reported = False
        """Whether the latched fault has been raised, or is older than this connection."""
        self.interlocks: tuple[str, ...] = ()
        """Names of the drive's interlock inputs, once read."""
        self._written: dict[str, float] = {}

    # Requests

    def request(
        self, request: Command | ParameterRead | ParameterWrite, timeout_s: float | None = None
    ) -> Ack | ParameterValue:
        """Repeat a request until its answer, which may be a refusal.

        Raises `DriveFault`: no_answer, or link_lost where the drive no longer knows this session.
        """
        reply = self._exchange(request, timeout_s or self._answer_s)
        if isinstance(reply, Ack) and reply.status is AckStatus.STALE_SESSION:
            message = "the drive no longer knows this session: it has restarted, or has another host"
            raise self.link.lose(DriveFault(FaultCause.LINK_LOST, message))
        return reply

    def _exchange(self, request: Command | ParameterRead | ParameterWrite, timeout_s: float) -> Ack | ParameterValue:
        for _ in range(math.ceil(timeout_s / TIMEOUTS.repeat_s)):
            self.link.send(request)
            reply = self.link.reply(lambda message: answers(message, request), TIMEOUTS.repeat_s)
            if reply is not None:
                return reply
        where = self.link.port.where
        raise DriveFault(FaultCause.NO_ANSWER, f"{where}: no answer to {_describe(request)} for {timeout_s:g} s")

    def command(self, op: Op, arg: int = 0, timeout_s: float | None = None) -> Ack:
        """A command's acknowledgement, of any status."""
        reply = self.request(self.conversation.command(op, arg), timeout_s)
        assert isinstance(reply, Ack)
        return reply

    def do(self, op: Op, arg: int = 0) -> Ack:
        """Send a command; raises `DriveRefused` with the drive's reason where it is refused."""
        ack = self.command(op, arg)
        if ack.status is not AckStatus.OK:
            raise refused(ack)
        return ack

    # Registers

    def read(self, name: str) -> float:
        """A register's value; raises `DriveFault` (wrong_data) where the drive lacks it."""
        reply = self.request(self.conversation.read(register_index(name)))
        if isinstance(reply, Ack):
            raise DriveFault(FaultCause.WRONG_DATA, f"register {name} cannot be read: {words(reply.status)}")
        return reply.value

    def write(self, values: Mapping[str, float], *, anew: bool = False) -> None:
        """Write values that differ from those written before, or all with `anew`.

        Raises `DriveRefused` with the drive's reason, `DriveFault` (wrong_data) where another value is read back.
        """
        for name, value in values.items():
            if anew or self._written.get(name) != value:
                self._written.pop(name, None)
                self._write(name, value)
                self._written[name] = value

    def _write(self, name: str, value: float) -> None:
        try:
            request = self.conversation.write(register_index(name), value)
        except InputError as error:
            raise DriveRefused(f"{name}: {error.problem}") from None
        reply = self.request(request)
        if isinstance(reply, Ack):
            raise DriveRefused(f"the drive refuses {name} = {value:g}: {words(reply.status)}")
        require_readback(name, value, reply.value)

    # Identification

    def identify(self, timeout_s: float) -> None:
        """Open a session; retries up to `timeout_s` for a drive that is silent, or armed by another host.

        A session number that the drive has closed before is replaced by another random one.
        Raises `DriveRefused` where it stays busy, or has another version.
        """
        deadline = time.monotonic() + timeout_s
        while (ack := self._identify_once(timeout_s)).status in (AckStatus.BUSY, AckStatus.STALE_SESSION):
            if time.monotonic() > deadline:
                raise DriveRefused("another host has the drive armed")
            if ack.status is AckStatus.STALE_SESSION:
                self.conversation = Conversation()
            else:
                time.sleep(TIMEOUTS.repeat_s)
        if ack.status is AckStatus.WRONG_VERSION:
            major = ack.value >> 8
            raise DriveRefused(f"the drive speaks version {major} of the protocol, this host version {PROTOCOL_MAJOR}")
        if ack.status is not AckStatus.OK:
            raise DriveRefused(f"the drive refuses a session: {words(ack.status)}")

    def _identify_once(self, timeout_s: float) -> Ack:
        ack = self._exchange(self.conversation.command(Op.IDENTIFY, PROTOCOL_MAJOR), timeout_s)
        assert isinstance(ack, Ack)
        return ack

    def own_registers(self) -> dict[str, float]:
        """The drive's read-only registers."""
        return {r.name: self.read(r.name) for r in registers().values() if r.access == "read"}

    def description(self, own: Mapping[str, float], layout: BlockLayout) -> dict[str, str]:
        """The drive's description."""
        length = int(own["description_bytes"])
        data = read_whole(self, DESCRIPTION_CAPTURE, length, layout) if length else b""
        return parse_description(bytes(data))

    # State

    def tick(self) -> Tick:
        """The drive's clock, now; requested again where only the acknowledgement arrives."""
        news = self.link.news
        ticks = news.ticks
        for _ in range(math.ceil(self._answer_s / TIMEOUTS.tick_s)):
            self.do(Op.TIME_SYNC)
            if self.link.wait(lambda: news.ticks > ticks, TIMEOUTS.tick_s) and news.tick is not None:
                return news.tick
        raise DriveFault(FaultCause.NO_ANSWER, "the drive does not report its clock")

    def fault(self) -> DriveFault:
        """The drive's latched fault as a `DriveFault`."""
        self.fault_reported = True
        cause, value, limit, bits = (self.read(name) for name in _FAULT_REGISTERS)
        return drive_fault(known_fault(cause), value, limit, int(bits), self.interlocks)


def refused(ack: Ack) -> DriveRefused:
    """Error of an acknowledgement that refuses its command."""
    return DriveRefused(f"the drive refuses to {words(ack.op)}: {words(ack.status)}")


def require_readback(name: str, expected: float, actual: float) -> None:
    """Raise `DriveFault` (wrong_data) where a register read back differs from what was written."""
    if actual != single(expected):
        raise DriveFault(FaultCause.WRONG_DATA, f"the drive holds {actual:g} as {name} instead of {expected:g}")


def known_fault(number: float) -> Fault:
    """The fault with a register's number; `internal` for an unknown one."""
    return Fault(int(number)) if number in set(Fault) else Fault.INTERNAL


def fault_names(status: Status) -> tuple[str, ...]:
    """Names of all latched faults, the cause first."""
    latched = [fault for fault in Fault if fault is not Fault.NONE and status.faults >> fault & 1]
    return tuple(fault.name.lower() for fault in sorted(latched, key=lambda fault: fault is not status.cause))


def words(member: Op | AckStatus) -> str:
    """Readable name of an enumeration's member."""
    return member.name.lower().replace("_", " ")


def _describe(request: Command | ParameterRead | ParameterWrite) -> str:
    if isinstance(request, Command):
        return words(request.op)
    verb = "reading" if isinstance(request, ParameterRead) else "writing"
    return f"{verb} register {request.parameter}"
