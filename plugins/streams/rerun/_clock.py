"""Where an event stands on the experiment's timeline. Samples bring the drive's clock, other messages bring none."""

from __future__ import annotations

import time
from collections.abc import Callable

_REAL_TIME_RATIO = (0.5, 2.0)


class Clock:
    """The drive's clock as far as it is known.

    A drive in real time is at the last sample's time plus what has passed since; a simulated one, faster than
    real time, stands still between its samples.
    """

    def __init__(self, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._wall = wall_s
        self._first: tuple[float, float] | None = None
        self._last = (0.0, wall_s())

    def seen(self, drive_s: float) -> None:
        """A sample of this time has just arrived."""
        if self._first is None:
            self._first = (drive_s, self._wall())
        self._last = (max(drive_s, self._last[0]), self._wall())

    def now(self) -> float:
        """The experiment's time [s]."""
        since = self._wall() - self._last[1]
        return self._last[0] + (since if self._keeps_pace() else 0.0)

    def _keeps_pace(self) -> bool:
        if self._first is None:
            return False
        drive, wall = self._last[0] - self._first[0], self._last[1] - self._first[1]
        return wall > 1.0 and _REAL_TIME_RATIO[0] < drive / wall < _REAL_TIME_RATIO[1]
