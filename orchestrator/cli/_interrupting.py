"""Ctrl-C while something is computed: one line and exit code 130 at once, whatever a plugin's thread is doing."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

from protocols import RunInterrupted


@contextmanager
def prompt_interrupt(grace_s: float = 0.6) -> Iterator[None]:
    """While the block lasts, SIGINT ends it, and the process where the block does not end soon.

    For blocks that leave nothing half written, from the main thread. Where SIGINT is ignored it stays so. The grace is
    for what is under way to end by itself: an evaluation takes some 20 ms, a plugin's may take for ever.

    Raises
    ------
    RunInterrupted
        In place of `KeyboardInterrupt`.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    asked = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            _leave()
        asked = True
        signal.setitimer(signal.ITIMER_REAL, grace_s)
        raise KeyboardInterrupt

    def overdue(number: int, frame: FrameType | None) -> None:
        _leave()

    before = signal.signal(signal.SIGALRM, overdue)
    signal.signal(signal.SIGINT, stop)
    after: Any = signal.default_int_handler
    try:
        yield
    except KeyboardInterrupt:
        # On the way out there is nothing more to interrupt: who asks twice gets the same line and code.
        after = signal.SIG_IGN
        raise RunInterrupted("interrupted") from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, after)
        signal.signal(signal.SIGALRM, before)


def _leave() -> NoReturn:
    os.write(2, b"fluxbench: interrupted\n")
    os._exit(130)
