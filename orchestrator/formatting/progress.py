"""Progress messages: on standard error at a terminal; in files and pipes results alone."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from orchestrator.formatting.sentences import cut, for_output


class Progress:
    """Prints the current step of a computation, with the time since its start.

    Parameters
    ----------
    where : TextIO, optional
        Standard error by default. A file or pipe gets no progress lines.
    clock : callable, optional
        Seconds, of any origin.
    results : TextIO, optional
        Output for `result` if `where` is no terminal; `where` by default.
    """

    def __init__(
        self,
        where: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        results: TextIO | None = None,
    ) -> None:
        self._where = sys.stderr if where is None else where
        self._results = self._where if results is None else results
        self._clock, self._began = clock, clock()
        self._next = self._began

    def __call__(self, text: str) -> None:
        now = self._clock()
        # An added effect is printed at once; other steps at most once a second.
        if not self._where.isatty() or (now < self._next and not text.startswith("+ ")):
            return
        self._next = now + 1.0
        self._print(f"{now - self._began:5.0f} s  {text}", self._where)

    def result(self, text: str) -> None:
        """Print a result: at a terminal at once with the time, in a file or pipe as a plain line."""
        if self._where.isatty():
            self._print(f"{self._clock() - self._began:5.0f} s  {text}", self._where)
        else:
            self._print(text, self._results)

    @staticmethod
    def _print(line: str, where: TextIO) -> None:
        print(for_output(cut(line), where), file=where, flush=True)
