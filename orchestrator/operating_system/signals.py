"""Signals: those that stop and those that pause a run, and an alarm for whatever takes too long."""

from __future__ import annotations

import _thread
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object]


def _present(*names: str) -> tuple[signal.Signals, ...]:
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


STOP_SIGNALS = _present("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
"""Requests to end: Ctrl-C, `kill`, a closed terminal, and Ctrl-\\ (Ctrl-Break on Windows)."""
PAUSE_SIGNALS = _present("SIGTSTP")
"""Request to stand still, Ctrl-Z; Windows has none."""
ALARM_SIGNAL = (*_present("SIGALRM"), signal.SIGABRT)[0]
"""Signal whose handler an `Alarm` calls."""


@contextmanager
def handlers(by_signal: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Install these handlers while the block lasts; from the main thread alone."""
    previous = {number: signal.signal(number, handler) for number, handler in by_signal.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def suspend_process() -> None:
    """Stop this process until it is told to continue; call it in the handler of a pause signal."""
    os.kill(os.getpid(), signal.SIGSTOP)


class Alarm:
    """Calls the handler of `ALARM_SIGNAL` in the main thread after a time; at most one alarm runs at once.

    Where the system has no such timer, a thread waits for it: the handler then runs between two steps of Python, and
    cannot interrupt a call into the system.
    """

    def __init__(self) -> None:
        self._waiting: _thread.LockType | None = None

    def start(self, seconds: float) -> None:
        """Begin; safe in a signal's handler, since it takes no lock that the main thread may hold."""
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, seconds)
            return
        waiting = self._waiting = _thread.allocate_lock()
        waiting.acquire()
        _thread.start_new_thread(_interrupt_later, (waiting, seconds))

    def cancel(self) -> None:
        """End without a call."""
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        elif self._waiting is not None:
            self._waiting.release()
            self._waiting = None


def _interrupt_later(cancelled: _thread.LockType, seconds: float) -> None:
    if not cancelled.acquire(timeout=seconds):
        _thread.interrupt_main(ALARM_SIGNAL)
