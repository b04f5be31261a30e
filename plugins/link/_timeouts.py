"""The host's timeouts and buffer sizes for a drive at the other end of a link."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Timeouts:
    """Times in seconds during which the host's process runs; a drive answers within milliseconds."""

    receive_s: float = 0.02
    """Longest wait for a frame in one turn of a loop: a beat or a fault is never further off."""
    send_s: float = 0.1
    """Time after which a link that takes nothing counts as stuck."""
    heartbeat_s: float = 0.01
    """The same for a heartbeat, which must return at once."""
    repeat_s: float = 0.05
    """A request without an answer is repeated after this time."""
    tick_s: float = 0.2
    """The clock follows its answer within this time, or has been lost."""
    upload_s: float = 0.06
    """Missing blocks are requested again after this silence; it doubles each time, until answers are in time."""
    max_upload_s: float = 0.24
    """Longest such silence: on a slow machine all answers may be on their way."""
    upload_lost_s: float = 0.8
    """Silence after which an upload is given up."""
    live_read_period_s: float = 0.02
    """Shortest time between requests to a drive that captures: each costs two frames, however few blocks it brings."""
    max_upload_rounds: int = 200
    """Successive rounds of requests without a new block, after which it is given up."""
    keepalive_period_s: float = 0.2
    """Time without rows after which an empty block is yielded."""
    no_progress_s: float = 5.0
    """Time beyond the settling time after which a program without progress is given up."""
    max_duration_ratio: float = 5.0
    """A program that takes this multiple of its planned time, and `no_progress_s` more, does not end."""
    clock_error_s: float = 0.2
    """Largest error of a drive's clock between two readings, beside `clock_error_ratio` of the time between."""
    clock_error_ratio: float = 0.1
    """Relative error beyond any oscillator's; a simulated clock declares itself."""
    ramp_s: float = 8.0
    """Time in which the current has to fall to zero."""
    settle_s: float = 1.0
    """Time in which the status has to show a change of state."""
    max_scheduling_gap_s: float = 0.1
    """Time between two readings of the host's clock, above which the process was stopped."""
    max_bulk_frames: int = 100_000
    """Most frames of captures that wait for their reader; a batch of requests brings fewer."""
    wake_bulk_frames: int = 256
    """Waiting frames that wake their reader; fewer wait for their answer's end, or for the timeout."""
    max_replies: int = 64
    """Most waiting answers; one request at a time is under way."""


TIMEOUTS = Timeouts()


class ProcessClock:
    """Seconds during which this process ran, not stopped or starved; read it in every turn of a waiting loop."""

    def __init__(self) -> None:
        self._last_s, self._total_s = time.monotonic(), 0.0

    def __call__(self) -> float:
        """Seconds since it was made."""
        now_s = time.monotonic()
        self._total_s += min(now_s - self._last_s, TIMEOUTS.max_scheduling_gap_s)
        self._last_s = now_s
        return self._total_s
