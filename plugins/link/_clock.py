"""A clock for patience: it stands still while this process is stopped, or kept from running. Waits for nothing."""

from __future__ import annotations

import time

from plugins.link._timeouts import TIMEOUTS


class AttentiveClock:
    """Seconds in which this process was there to listen; to be read in every turn of a loop that waits."""

    def __init__(self) -> None:
        self._seen_s, self._total_s = time.monotonic(), 0.0

    def __call__(self) -> float:
        """Seconds since it was made."""
        now_s = time.monotonic()
        self._total_s += min(now_s - self._seen_s, TIMEOUTS.max_scheduling_gap_s)
        self._seen_s = now_s
        return self._total_s
