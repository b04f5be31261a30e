"""Signals before a run handles them itself: while a second of imports goes by, nothing that is asked for is lost.

Nothing is energised yet, and nothing half written: who asks to stop is obeyed at once. That includes a process that
was started with signals ignored (in the background of a script, or under nohup), as runs do later.
"""

import os
import signal
from contextlib import suppress
from types import FrameType

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class EarlySignals:
    """Handlers from the first line of the program on.

    SIGINT, SIGTERM, SIGHUP and SIGQUIT end the process with one line and exit code 130; SIGTSTP stops it, also where
    the system itself would pass over it (a process group without a shell), until SIGCONT.
    """

    def __init__(self) -> None:
        handlers = dict.fromkeys(STOP_SIGNALS, _leave) | {signal.SIGTSTP: _stand_still}
        self._before = {number: signal.signal(number, handler) for number, handler in handlers.items()}

    def settle(self, energises: bool) -> None:
        """It is known which command it is: one that energises keeps them, until its run brings its own.

        All others have what they were started with.
        """
        if not energises:
            for number, handler in self._before.items():
                signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None) -> None:
    with suppress(OSError):  # the terminal is gone
        os.write(2, f"fluxbench: interrupted by {signal.Signals(number).name}\n".encode())
    os._exit(130)


def _stand_still(number: int, frame: FrameType | None) -> None:
    os.kill(os.getpid(), signal.SIGSTOP)
