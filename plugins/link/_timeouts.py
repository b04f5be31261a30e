"""How long the host waits for a drive at the other end of a link, and how much it keeps meanwhile."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Timeouts:
    """Times in seconds of a host that was there to listen; a drive answers within milliseconds."""

    listen_s: float = 0.02
    """Longest wait for a frame in one turn of a loop: a beat or a fault is never further off."""
    send_s: float = 0.1
    """A link that takes nothing for so long is stuck."""
    beat_s: float = 0.01
    """The same for a heartbeat, which must return at once."""
    repeat_s: float = 0.05
    """A request without an answer is repeated after this time."""
    tick_s: float = 0.2
    """The clock follows its answer within this time, or has been lost."""
    upload_s: float = 0.06
    """Missing blocks are requested again after this silence; it doubles each time, until answers are in time."""
    most_upload_s: float = 0.24
    """As far as that is doubled: on a slow machine all answers may be on their way."""
    upload_lost_s: float = 0.8
    """An upload of which nothing comes for so long is given up."""
    live_s: float = 0.02
    """Shortest time between requests to a drive that captures: each costs two frames, however few blocks it brings."""
    rounds: int = 200
    """Rounds of requests in a row that bring no new block before it is given up."""
    quiet_s: float = 0.2
    """A block without rows is yielded when none with rows came for so long."""
    stuck_s: float = 5.0
    """A program whose progress stands still for longer than it has to settle, and this, is given up."""
    slow: float = 5.0
    """A program that takes this multiple of its planned time, and `stuck_s` more, does not end."""
    clock_s: float = 0.2
    """What a drive's clock may be off between two looks at it, beside `clock_part` of the time between."""
    clock_part: float = 0.1
    """No oscillator is that far off; what is simulated says so."""
    ramp_s: float = 8.0
    """A current that is not zero after so long is not ramping down."""
    settle_s: float = 1.0
    """A change of state that does not show in the status after so long has not happened."""
    held_s: float = 0.1
    """More than this between two looks at the clock, and somebody has held the process."""
    most_bulk: int = 100_000
    """Frames of captures that wait for their reader; more than a batch of requests brings."""
    many_bulk: int = 256
    """So many wake who waits for them; fewer wait for the end of their answer, or for the time to be over."""
    most_replies: int = 64
    """Answers that wait; one request at a time is under way."""


TIMEOUTS = Timeouts()
