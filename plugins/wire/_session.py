"""Which messages count: sequence numbers, sessions, what feeds the watchdog, the age of telemetry. No I/O, no clocks.

Both ends use these, so that both agree on what is new, what is a repetition and what is stale.
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
    """Whether a sequence number follows another one, which may have wrapped: by less than half the circle."""
    return 0 < (seq - than) % (1 << bits) < 1 << (bits - 1)


class Unwrapped:
    """A counter that wraps on the wire and goes on here (the drive's tick); late values are looked up, not taken."""

    def __init__(self, bits: int = 32) -> None:
        self._bits = bits
        self._latest: int | None = None

    def __call__(self, value: int) -> int:
        """The count without wraps: nearest to the latest one."""
        if self._latest is None:
            self._latest = value
            return value
        half = 1 << (self._bits - 1)
        count = self._latest + (value - self._latest + half) % (2 * half) - half
        self._latest = max(self._latest, count)
        return count


class TelemetryGate:
    """Lets only newer telemetry in, and knows when it has become stale; one for each periodic message."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._seq: int | None = None
        self._taken_s = -math.inf

    def accept(self, seq: int, now_s: float) -> bool:
        """Whether a message is newer than all before; when stale, any is: the drive may have restarted."""
        if self._seq is not None and not newer(seq, self._seq) and not self.stale(now_s):
            return False
        self._seq, self._taken_s = seq, now_s
        return True

    def stale(self, now_s: float) -> bool:
        """Whether nothing newer came for three periods."""
        return now_s - self._taken_s > STALE_PERIODS * self.period_s


class Conversation:
    """The host's side of stop-and-wait: makes requests and recognises their answers. One request at a time."""

    def __init__(self, session: int | None = None) -> None:
        self.session = secrets.randbelow(0xFFFF) + 1 if session is None else session
        self._seq = secrets.randbelow(256)
        self._beat = 0

    def command(self, op: Op, arg: int = 0) -> Command:
        """The next command."""
        return Command(self.session, self._next(), op, arg)

    def write(self, index: int, value: float) -> ParameterWrite:
        """The next parameter write; raises `InputError` where the value is no finite single."""
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
        """The next heartbeat. Counts on its own, so that it may come from another thread."""
        self._beat = (self._beat + 1) % 256
        return Heartbeat(self.session, self._beat, int(now_s * 1e3) % (1 << 32))

    def armed(self, ack: Ack) -> None:
        """Go on in the session that the drive issued."""
        self.session = ack.value

    def _next(self) -> int:
        self._seq = (self._seq + 1) % 256
        return self._seq


def answers(message: Message, request: Request) -> bool:
    """Whether a message is the answer to this request, refusals included."""
    if not isinstance(message, (Ack, ParameterValue)) or message[:2] != request[:2]:
        return False
    if isinstance(message, ParameterValue):
        return not isinstance(request, Command) and message.parameter == request.parameter
    return message.op is (request.op if isinstance(request, Command) else _OP_OF[type(request)])


class Verdict(Enum):
    """What the drive does with a request."""

    NEW = "new"
    REPEATED = "repeated"
    """Send the stored reply again, do nothing."""
    OLD = "old"
    """Drop it: a late copy."""
    STALE = "stale"
    """Of another session: answer stale_session, do nothing."""


class Ledger:
    """The drive's side of stop-and-wait: which request is new, and the reply to the last one."""

    def __init__(self) -> None:
        self.session = 0
        self._seq = 0
        self._last: tuple[int, int] | None = None
        self._reply: Reply | None = None
        self._closed: deque[int] = deque(maxlen=16)

    def judge(self, request: Request) -> Verdict:
        """What to do with a request; a new one must be answered through `store`.

        `identify` opens a session that was not known; one that was closed stays closed. Whether it
        may be opened now (not while another host has the drive armed) is the drive's to say, before
        `open`. Reads are never repeated: judge them for the sake of the sequence and answer always.
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
        """Take up the session of an `identify`."""
        if request.session != self.session:
            self._closed.append(self.session)
            self.session, self._seq = request.session, request.seq

    def issue(self) -> int:
        """A new random session, on arming; the one before is closed."""
        known = {0, self.session, *self._closed}
        self._closed.append(self.session)
        while (session := secrets.randbelow(0xFFFF) + 1) in known:
            pass
        self.session = session
        return session

    def store(self, request: Request, reply: Reply) -> Reply:
        """Keep the reply for repetitions, and hand it back."""
        self._last, self._reply = (request.session, request.seq), reply
        return reply

    @property
    def reply(self) -> Reply:
        """The stored reply; after `Verdict.REPEATED` only."""
        assert self._reply is not None
        return self._reply


class Watchdog:
    """The drive's dead man: fed by heartbeats of the session alone, that are newer and were not held up."""

    _REMEMBERED = 64

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self.last_seq = 0
        self._fed_s = -math.inf
        self._fresh = True
        self._delays: deque[float] = deque(maxlen=self._REMEMBERED)

    def start(self, now_s: float) -> None:
        """On arming: the time runs from here, and any first heartbeat of the session is taken."""
        self._fed_s, self._fresh = now_s, True
        self._delays.clear()

    def feed(self, beat: Heartbeat, session: int, now_s: float) -> bool:
        """Whether this heartbeat was taken.

        It must not have been under way longer than the quickest of the last ones by more than the
        limit: what a stopped link hands over later in one go is no sign of life.
        """
        if beat.session != session or not (self._fresh or newer(beat.seq, self.last_seq)):
            return False
        delay = (now_s - beat.host_ms * 1e-3) % _HOST_CLOCK_S
        late = bool(self._delays) and _ahead(delay, self._delays) > self.limit_s
        self._delays.append(delay)
        self.last_seq, self._fresh = beat.seq, False
        if late:
            return False
        self._fed_s = now_s
        return True

    def expired(self, now_s: float) -> bool:
        """Whether the safe state is due. Ask before reading the link, not after."""
        return now_s - self._fed_s > self.limit_s


_HOST_CLOCK_S = (1 << 32) * 1e-3


def _ahead(delay: float, others: deque[float]) -> float:
    """How much longer than the shortest of the others, on a clock that wraps."""
    half = 0.5 * _HOST_CLOCK_S
    return max((delay - other + half) % _HOST_CLOCK_S - half for other in others)
