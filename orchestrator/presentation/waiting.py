"""What is said to who waits at a terminal: a line a second at most, on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from orchestrator.presentation.sentences import cut, for_output


class Waiting:
    """Says what is under way, and since when; nothing where nobody looks.

    Parameters
    ----------
    where : TextIO, optional
        Standard error by default. A file or pipe gets no line.
    clock : callable, optional
        Seconds, of any origin.
    """

    def __init__(self, where: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._where = sys.stderr if where is None else where
        self._clock, self._began = clock, clock()
        self._next = self._began

    def __call__(self, text: str) -> None:
        now = self._clock()
        # What was found is said at once; what is being done may be said again soon enough.
        if not self._where.isatty() or (now < self._next and not text.startswith("+ ")):
            return
        self._next = now + 1.0
        print(for_output(cut(f"{now - self._began:5.0f} s  {text}"), self._where), file=self._where, flush=True)
