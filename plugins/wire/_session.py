"""Validity of messages: sequence numbers, sessions, watchdog, age of telemetry. Pure logic.

Both ends use it and thus agree on which messages are new, repeated or stale.
"""

from __future__ import annotations

import math
import secrets
from collections import deque
from enum import Enum

from plugins.wire._codec import single
from plugins.wire._messages import (
    STALE_PERIODS,
    Ack,
    Command,
    Heartbeat,
    Message,
    Op,
    ParameterRead,
    ParameterValue,
    ParameterWrite,
)
from protocols import InputError

Request = Command | ParameterWrite | ParameterRead
Reply = Ack | ParameterValue
_OP_OF = {ParameterWrite: Op.PARAMETER_WRITE, ParameterRead: Op.PARAMETER_READ}


def newer(seq: int, than: int, bits: int = 8) -> bool:
    """Whether a wrapping sequence number is ahead of another one by less than half its range."""
    return 0 < (seq - than) % (1 << bits) < 1 << (bits - 1)


class Unwrapped:
    """Unwraps a counter (the drive's tick); an older value does not change the state."""

    def __init__(self, bits: int = 32) -> None:
        self._bits = bits
        self._latest: int | None = None

    def __call__(self, value: int) -> int:
        """The unwrapped count nearest to the latest one."""
        if self._latest is None:
            self._latest = value
            return value
        half = 1 << (self._bits - 1)
        count = self._latest + (value - self._latest + half) % (2 * half) - half
        self._latest = max(self._latest, count)
        return count


class TelemetryGate:
    """Accepts only newer telemetry and detects stale telemetry; one for each periodic message."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._seq: int | None = None
        self._taken_s = -math.inf

    def accept(self, seq: int, now_s: float) -> bool:
        """Whether a message is newer than all before; any is after staleness, since the drive may have restarted."""
        if self._seq is not None and not newer(seq, self._seq) and not self.stale(now_s):
            return False
        self._seq, self._taken_s = seq, now_s
        return True

    def stale(self, now_s: float) -> bool:
        """Whether no newer message was accepted for three periods."""
        return now_s - self._taken_s > STALE_PERIODS * self.period_s


class Conversation:
    """The host's side of stop-and-wait: numbers requests, one at a time."""

    def __init__(self, session: int | None = None) -> None:
        self.session = secrets.randbelow(0xFFFF) + 1 if session is None else session
        self._seq = secrets.randbelow(256)
        self._beat = 0

    def command(self, op: Op, arg: int = 0) -> Command:
        """The next command."""
        return Command(self.session, self._next(), op, arg)

    def write(self, index: int, value: float) -> ParameterWrite:
        """The next parameter write; raises `InputError` where the value is not a finite single."""
        try:
            finite = math.isfinite(single(value))
        except OverflowError:
            finite = False
        if not finite:
            raise InputError("wire", f"register {index}", f"{value:g} is not a finite single")
        return ParameterWrite(self.session, self._next(), index, value)

    def read(self, index: int) -> ParameterRead:
        """The next parameter read."""
        return ParameterRead(self.session, self._next(), index)

    def heartbeat(self, now_s: float) -> Heartbeat:
        """The next heartbeat; its separate counter permits another thread."""
        self._beat = (self._beat + 1) % 256
        return Heartbeat(self.session, self._beat, int(now_s * 1e3) % (1 << 32))

    def armed(self, ack: Ack) -> None:
        """Continue in the session that the drive issued."""
        self.session = ack.value

    def _next(self) -> int:
        self._seq = (self._seq + 1) % 256
        return self._seq


def answers(message: Message, request: Request) -> bool:
    """Whether a message answers this request; refusals do."""
    if not isinstance(message, (Ack, ParameterValue)) or message[:2] != request[:2]:
        return False
    if isinstance(message, ParameterValue):
        return not isinstance(request, Command) and message.parameter == request.parameter
    return message.op is (request.op if isinstance(request, Command) else _OP_OF[type(request)])


class Verdict(Enum):
    """The drive's treatment of a request."""

    NEW = "new"
    REPEATED = "repeated"
    """Send the stored reply again without acting."""
    OLD = "old"
    """Drop the request, a late copy."""
    STALE = "stale"
    """Request of another session: answer stale_session without acting."""


class Ledger:
    """The drive's side of stop-and-wait: detects new requests and keeps the last reply."""

    def __init__(self) -> None:
        self.session = 0
        self._seq = 0
        self._last: tuple[int, int] | None = None
        self._reply: Reply | None = None
        self._closed: deque[int] = deque(maxlen=16)

    def judge(self, request: Request) -> Verdict:
        """Treatment of a request; the answer to a new one must pass through `store`.

        `identify` opens an unknown session; a closed one stays closed. Before `open`, the drive has to
        check that no other host has it armed. Reads are never repetitions: judge them to advance the
        sequence, and always answer.
        """
        session, seq = request[:2]
        if (session, seq) == self._last and not isinstance(request, ParameterRead):
            return Verdict.REPEATED
        if session != self.session or session == 0:
            opens = isinstance(request, Command) and request.op is Op.IDENTIFY and session not in self._closed
            return Verdict.NEW if opens and session else Verdict.STALE
        if not newer(seq, self._seq):
            return Verdict.OLD
        self._seq = seq
        return Verdict.NEW

    def open(self, request: Command) -> None:
        """Open the session of an `identify`."""
        if request.session != self.session:
            self._closed.append(self.session)
            self.session, self._seq = request.session, request.seq

    def issue(self) -> int:
        """A new random session, on arming; the previous one is closed."""
        known = {0, self.session, *self._closed}
        self._closed.append(self.session)
        while (session := secrets.randbelow(0xFFFF) + 1) in known:
            pass
        self.session = session
        return session

    def store(self, request: Request, reply: Reply) -> Reply:
        """Store the reply for repetitions and return it."""
        self._last, self._reply = (request.session, request.seq), reply
        return reply

    @property
    def reply(self) -> Reply:
        """The stored reply, valid after `Verdict.REPEATED`."""
        assert self._reply is not None
        return self._reply


class Watchdog:
    """The drive's watchdog, fed by newer heartbeats of the session that were not delayed."""

    _MAX_DELAYS = 64

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self.last_seq = 0
        self._fed_s = -math.inf
        self._fresh = True
        self._delays: deque[float] = deque(maxlen=self._MAX_DELAYS)

    def start(self, now_s: float) -> None:
        """Start the timeout on arming; the first heartbeat of the session is accepted in any case."""
        self._fed_s, self._fresh = now_s, True
        self._delays.clear()

    def feed(self, beat: Heartbeat, session: int, now_s: float) -> bool:
        """Whether this heartbeat was accepted.

        Its transmission delay may exceed the shortest recent one by at most the limit, so that
        heartbeats which a stalled link delivers late do not count.
        """
        if beat.session != session or not (self._fresh or newer(beat.seq, self.last_seq)):
            return False
        delay = (now_s - beat.host_ms * 1e-3) % _HOST_CLOCK_S
        late = bool(self._delays) and _excess_delay(delay, self._delays) > self.limit_s
        self._delays.append(delay)
        self.last_seq, self._fresh = beat.seq, False
        if late:
            return False
        self._fed_s = now_s
        return True

    def expired(self, now_s: float) -> bool:
        """Whether the timeout has passed; to be checked before reading the link."""
        return now_s - self._fed_s > self.limit_s


_HOST_CLOCK_S = (1 << 32) * 1e-3


def _excess_delay(delay: float, others: deque[float]) -> float:
    """Excess of a delay over the shortest of others, on a clock that wraps [s]."""
    half = 0.5 * _HOST_CLOCK_S
    return max((delay - other + half) % _HOST_CLOCK_S - half for other in others)
