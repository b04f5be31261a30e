"""What is said to who waits: at a terminal what is under way, on standard error; anywhere else what is to be kept."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from orchestrator.formatting.sentences import cut, for_output


class Waiting:
    """Says what is under way, and since when.

    Parameters
    ----------
    where : TextIO, optional
        Standard error by default. A file or pipe gets no line of what is under way.
    clock : callable, optional
        Seconds, of any origin.
    kept : TextIO, optional
        Where the lines of `keep` go if `where` is no terminal; by default there too.
    """

    def __init__(
        self,
        where: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        kept: TextIO | None = None,
    ) -> None:
        self._where = sys.stderr if where is None else where
        self._kept = self._where if kept is None else kept
        self._clock, self._began = clock, clock()
        self._next = self._began

    def __call__(self, text: str) -> None:
        now = self._clock()
        # What was found is said at once; what is being done may be said again soon enough.
        if not self._where.isatty() or (now < self._next and not text.startswith("+ ")):
            return
        self._next = now + 1.0
        self._print(f"{now - self._began:5.0f} s  {text}", self._where)

    def keep(self, text: str) -> None:
        """Say what is to be read by everybody: at a terminal at once, in a file or pipe as a plain line."""
        if self._where.isatty():
            self._print(f"{self._clock() - self._began:5.0f} s  {text}", self._where)
        else:
            self._print(text, self._kept)

    @staticmethod
    def _print(line: str, where: TextIO) -> None:
        print(for_output(cut(line), where), file=where, flush=True)
