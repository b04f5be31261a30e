"""Progress of a job and its remaining time, as one line."""

from __future__ import annotations

import time
from collections.abc import Callable

from orchestrator.formatting.quantities import duration


class JobProgress:
    """Counts the finished items of a known number.

    Parameters
    ----------
    total : int
    tell : callable
        Called with the line after each item.
    clock : callable, optional
        Seconds, of any origin.
    """

    def __init__(self, total: int, tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._tell, self._clock, self._began = total, tell, clock, clock()
        self._done, self._failed, self._skipped = 0, 0, 0

    def skip(self) -> None:
        """Count an item without work."""
        self._skipped += 1

    def done(self, failed: bool = False) -> None:
        """Count a finished item."""
        self._done += 1
        self._failed += failed
        self._tell(self.line())

    def line(self) -> str:
        """``120 of 500 done, 2 failed, 1.9 a second, 3 min 20 s left``."""
        seconds = max(self._clock() - self._began, 1e-9)
        remaining = self._total - self._skipped - self._done
        words = [f"{self._skipped + self._done} of {self._total} done"]
        if self._failed:
            words.append(f"{self._failed} failed")
        words.append(f"{self._done / seconds:.3g} a second")
        if remaining > 0 and self._done:
            words.append(f"{duration(remaining * seconds / self._done)} left")
        return ", ".join(words)
