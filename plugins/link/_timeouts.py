"""The host's timeouts and buffer sizes for a drive at the other end of a link."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Timeouts:
    """Times in seconds, measured while the host's process runs; a drive answers within milliseconds."""

    receive_s: float = 0.02
    """Longest wait for a frame in one pass of a loop, hence the largest delay of a heartbeat or fault."""
    send_s: float = 0.1
    """Time after which a link that accepts no data counts as stuck."""
    heartbeat_s: float = 0.01
    """As `send_s`, for a heartbeat, which must not block."""
    repeat_s: float = 0.05
    """A request without an answer is repeated after this time."""
    tick_s: float = 0.2
    """Time after its acknowledgement within which a tick arrives, or else is lost."""
    upload_s: float = 0.06
    """Silence after which missing blocks are requested again; doubled each time until answers arrive in time."""
    max_upload_s: float = 0.24
    """Longest such silence, for slow machines with delayed answers."""
    upload_lost_s: float = 0.8
    """Silence after which an upload fails."""
    live_read_period_s: float = 0.02
    """Shortest time between requests to a capturing drive: each costs two frames besides its blocks."""
    max_upload_rounds: int = 200
    """Successive rounds of requests without a new block after which an upload fails."""
    keepalive_period_s: float = 0.2
    """Time without rows after which an empty block is yielded."""
    no_progress_s: float = 5.0
    """Time beyond the settling time after which a program without progress fails."""
    max_duration_ratio: float = 5.0
    """Longest duration of a program over the planned one (plus `no_progress_s`)."""
    clock_error_s: float = 0.2
    """Largest error of a drive's clock between two readings, plus `clock_error_ratio` times their distance."""
    clock_error_ratio: float = 0.1
    """Relative clock error, larger than that of any oscillator."""
    ramp_s: float = 8.0
    """Time in which the current has to fall to zero."""
    settle_s: float = 1.0
    """Time in which the status has to show a change of state."""
    max_scheduling_gap_s: float = 0.1
    """Time between two readings of the host's clock above which the process was suspended."""
    max_bulk_frames: int = 100_000
    """Largest number of queued capture frames, more than a batch of requests returns."""
    wake_bulk_frames: int = 256
    """Queued frames that wake their reader; fewer wait for the answer's end or the timeout."""
    max_replies: int = 64
    """Largest number of queued answers; one request is pending at a time."""


TIMEOUTS = Timeouts()


class ProcessClock:
    """Time during which this process ran, without suspension; to be read in every pass of a waiting loop."""

    def __init__(self) -> None:
        self._last_s, self._total_s = time.monotonic(), 0.0

    def __call__(self) -> float:
        """Seconds since its creation."""
        now_s = time.monotonic()
        self._total_s += min(now_s - self._last_s, TIMEOUTS.max_scheduling_gap_s)
        self._last_s = now_s
        return self._total_s
