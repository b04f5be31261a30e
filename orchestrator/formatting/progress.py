"""Progress messages: on standard error at a terminal; in files and pipes beside the results, and fewer of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

from orchestrator.formatting.sentences import cut, for_output

LINE_PERIOD_S = 1.0
"""Least time between two steps at a terminal; an added effect is printed at once."""
FILE_LINE_PERIOD_S = 10.0
"""Least time between two steps in a file or pipe, and before the first one."""


class Progress:
    """Prints the current step of a computation, with the time since its start.

    Parameters
    ----------
    where : TextIO, optional
        Standard error by default.
    clock : callable, optional
        Seconds, of any origin.
    results : TextIO, optional
        Output if `where` is no terminal; `where` by default.
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
        self._next = self._began if self._where.isatty() else self._began + FILE_LINE_PERIOD_S

    def __call__(self, text: str) -> None:
        now = self._clock()
        on_terminal = self._where.isatty()
        if now < self._next and not (on_terminal and text.startswith("+ ")):
            return
        self._next = now + (LINE_PERIOD_S if on_terminal else FILE_LINE_PERIOD_S)
        self._print(f"{now - self._began:5.0f} s  {text}", self._where if on_terminal else self._results)

    def result(self, text: str) -> None:
        """Print a result: at a terminal at once with the time, in a file or pipe as a plain line."""
        if self._where.isatty():
            self._print(f"{self._clock() - self._began:5.0f} s  {text}", self._where)
        else:
            self._print(text, self._results)

    @staticmethod
    def _print(line: str, where: TextIO) -> None:
        print(for_output(cut(line), where), file=where, flush=True)
