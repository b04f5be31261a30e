"""Waiting for input of a pipe or a terminal, with a timeout: ``select`` waits for sockets alone on Windows."""

from __future__ import annotations

import os
import select
import time
from importlib import import_module

POLL_PERIOD_S = 0.02
"""Period in which Windows is asked for input."""


def wait_for_input(descriptor: int, timeout_s: float) -> bool:
    """Whether reading a descriptor returns at once, with data or at the end; False after the timeout.

    On Windows a terminal's line counts from its first key on.
    """
    if hasattr(select, "poll"):
        return bool(select.select([descriptor], [], [], timeout_s)[0])
    deadline = time.monotonic() + timeout_s
    while not _has_input(descriptor):
        if time.monotonic() >= deadline:
            return False
        time.sleep(POLL_PERIOD_S)
    return True


def _has_input(descriptor: int) -> bool:
    msvcrt = import_module("msvcrt")  # by name: type checkers know it on Windows alone
    if os.isatty(descriptor):
        return bool(msvcrt.kbhit())
    try:
        return bool(import_module("_winapi").PeekNamedPipe(msvcrt.get_osfhandle(descriptor), 0)[0])
    except OSError:  # its end, or a file
        return True
