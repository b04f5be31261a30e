"""How far a job is, and how long it takes yet, as one line."""

from __future__ import annotations

import time
from collections.abc import Callable

from orchestrator.formatting.quantities import duration


class Progress:
    """Counts what is done of a number that is known.

    Parameters
    ----------
    total : int
    tell : callable
        Called with the line; how often it is shown is its business.
    clock : callable, optional
        Seconds, of any origin.
    """

    def __init__(self, total: int, tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._total, self._tell, self._clock, self._began = total, tell, clock, clock()
        self._done, self._failed, self._skipped = 0, 0, 0

    def passed_over(self) -> None:
        """One more for which there is nothing to do."""
        self._skipped += 1

    def done(self, failed: bool = False) -> None:
        """One more is done."""
        self._done += 1
        self._failed += failed
        self._tell(self.line())

    def line(self) -> str:
        """``120 of 500 done, 2 failed, 1.9 a second, 3 min 20 s left``."""
        seconds = max(self._clock() - self._began, 1e-9)
        left = self._total - self._skipped - self._done
        words = [f"{self._skipped + self._done} of {self._total} done"]
        if self._failed:
            words.append(f"{self._failed} failed")
        words.append(f"{self._done / seconds:.3g} a second")
        if left > 0 and self._done:
            words.append(f"{duration(left * seconds / self._done)} left")
        return ", ".join(words)
