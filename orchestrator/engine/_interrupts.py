"""Requests to stop or to pause, from signals or from another thread, handled where it is safe.

A request only sets a flag; the engine looks at it between blocks of samples and between points.
Handlers are installed by `handling_signals` alone, for as long as a run lasts.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from orchestrator.operating_system.signals import (
    ALARM_SIGNAL,
    PAUSE_SIGNALS,
    STOP_SIGNALS,
    Alarm,
    handlers,
    suspend_process,
)
from protocols import DriveFault, FaultCause, RunInterrupted


class Interrupts:
    """Requests to a run from outside; safe to call from any thread or handler.

    Parameters
    ----------
    suspend : callable, optional
        Called in the paused state; returns when the run is to go on. The default waits for
        `resume`.
    """

    def __init__(self, suspend: Callable[[], None] | None = None) -> None:
        self._stop: str | None = None
        self._pause = False
        self._resumed = threading.Event()
        self._suspend = suspend
        self._has_alarm = False

    def stop(self, reason: str) -> None:
        """Ask the run to end; the first reason counts."""
        self._stop = self._stop or reason
        self._resumed.set()

    def pause(self) -> None:
        """Ask the run to stand still, disarmed, after the point under way."""
        self._resumed.clear()
        self._pause = True

    def resume(self) -> None:
        """Let a paused run go on."""
        self._resumed.set()

    def check(self) -> None:
        """Raise `RunInterrupted` after a request to stop."""
        if self._stop is not None:
            raise RunInterrupted(self._stop)

    @contextmanager
    def deadline(self, seconds: float) -> Iterator[None]:
        """Raise `DriveFault` (no answer) in the block when it lasts longer, whatever it is waiting in.

        Works where signals are handled (`handling_signals`), and is no limit elsewhere.
        """
        if not self._has_alarm:
            yield
            return
        alarm = Alarm()
        alarm.start(seconds)
        try:
            yield
        finally:
            alarm.cancel()

    @property
    def pause_wanted(self) -> bool:
        return self._pause

    def wait_until_resumed(self) -> None:
        """Stand still until the run is to go on, or to end."""
        if self._suspend is not None:
            self._suspend()
        else:
            self._resumed.wait()
        self._pause = False
        self.check()


@contextmanager
def handling_signals() -> Iterator[Interrupts]:
    """Context that turns signals into requests; restores the previous handlers.

    `STOP_SIGNALS` stop the run; `ALARM_SIGNAL` ends a `deadline`; SIGTSTP (Ctrl-Z) pauses:
    the drive is disarmed first, then the process really stops, and SIGCONT (``fg``) lets
    it go on. A second stop signal has no effect: the shutdown is already running.
    """
    interrupts = Interrupts(suspend=suspend_process)

    def stop(number: int, frame: FrameType | None) -> None:
        interrupts.stop(f"signal {signal.Signals(number).name}")

    def pause(number: int, frame: FrameType | None) -> None:
        interrupts.pause()

    def overdue(number: int, frame: FrameType | None) -> None:
        raise DriveFault(FaultCause.NO_ANSWER, "the drive neither sends samples nor returns")

    interrupts._has_alarm = True
    with handlers(dict.fromkeys(STOP_SIGNALS, stop) | dict.fromkeys(PAUSE_SIGNALS, pause) | {ALARM_SIGNAL: overdue}):
        yield interrupts
