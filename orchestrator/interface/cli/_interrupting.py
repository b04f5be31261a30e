"""Ctrl-C during a computation: exit code 130, with the result so far where there is one, else at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, NoReturn

from orchestrator.operating_system.signals import ALARM_SIGNAL, Alarm, handlers
from protocols import RunInterrupted


@dataclass
class Interruption:
    """Whether the user pressed Ctrl-C, and whether the block has a result to report by then."""

    has_result: bool = False
    requested: bool = False


@contextmanager
def prompt_interrupt(interruption: Interruption | None = None, grace_s: float = 0.6) -> Iterator[None]:
    """While the block lasts, SIGINT ends it, and the process where the block does not end soon.

    For blocks that leave nothing half written, from the main thread. Where SIGINT is ignored it stays so. Within the
    grace period the current evaluation may end by itself: it takes some 20 ms, a plugin's may take for ever. A block
    that has a result may take longer to report it; a second SIGINT ends the process.

    Parameters
    ----------
    interruption : Interruption, optional
        In it the block marks that it has a result, and reads that it was interrupted.

    Raises
    ------
    RunInterrupted
        In place of `KeyboardInterrupt`.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    state, alarm = interruption or Interruption(), Alarm()

    def stop(number: int, frame: FrameType | None) -> None:
        if state.requested:
            _exit()
        state.requested = True
        if state.has_result:
            os.write(2, b"fluxbench: ending early with the result so far (Ctrl-C again ends at once)\n")
        else:
            alarm.start(grace_s)
        raise KeyboardInterrupt

    def overdue(number: int, frame: FrameType | None) -> None:
        _exit()

    after: Any = signal.default_int_handler
    with handlers({ALARM_SIGNAL: overdue}):
        signal.signal(signal.SIGINT, stop)
        try:
            yield
        except KeyboardInterrupt:
            # On the way out there is nothing more to interrupt: a second Ctrl-C gives the same line and code.
            after = signal.SIG_IGN
            raise RunInterrupted("interrupted") from None
        finally:
            alarm.cancel()
            signal.signal(signal.SIGINT, after)


def _exit() -> NoReturn:
    os.write(2, b"fluxbench: interrupted\n")
    os._exit(130)
