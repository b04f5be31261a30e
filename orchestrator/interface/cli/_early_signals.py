"""Signals before a run handles them itself: during the second that imports take, no request to stop is lost.

Nothing is energised or half written yet, so that a signal ends the process at once. That includes a process that was
started with signals ignored (in the background of a script, or under nohup), as in runs later.
"""

import os
import signal
from contextlib import suppress
from types import FrameType

from orchestrator.operating_system.signals import PAUSE_SIGNALS, STOP_SIGNALS, suspend_process


class EarlySignals:
    """Handlers from the first line of the program on.

    SIGINT, SIGTERM, SIGHUP and SIGQUIT end the process with one line and exit code 130; SIGTSTP stops it until SIGCONT,
    also where the system itself would ignore it (a process group without a shell).
    """

    def __init__(self) -> None:
        handlers = dict.fromkeys(STOP_SIGNALS, _exit) | dict.fromkeys(PAUSE_SIGNALS, _suspend)
        self._before = {number: signal.signal(number, handler) for number, handler in handlers.items()}

    def settle(self, energises: bool) -> None:
        """Restore the handlers of the start, unless the command energises and its run installs its own later."""
        if not energises:
            for number, handler in self._before.items():
                signal.signal(number, handler)


def _exit(number: int, frame: FrameType | None) -> None:
    with suppress(OSError):  # the terminal is gone
        os.write(2, f"fluxbench: interrupted by {signal.Signals(number).name}\n".encode())
    os._exit(130)


def _suspend(number: int, frame: FrameType | None) -> None:
    suspend_process()
