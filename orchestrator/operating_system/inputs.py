"""Waiting for input of a pipe or a terminal, with a timeout: ``select`` waits for sockets alone on Windows."""

from __future__ import annotations

import time
from importlib import import_module

POLL_PERIOD_S = 0.02


def wait_for_input(descriptor: int, timeout_s: float) -> bool:
    """Whether reading a descriptor returns at once, with data or at the end; False after the timeout.

    On Windows a terminal's line counts from its first key on.
    """
    try:
        msvcrt = import_module("msvcrt")  # by name: type checkers know it on Windows alone
    except ImportError:
        import select

        return bool(select.select([descriptor], [], [], timeout_s)[0])
    deadline = time.monotonic() + timeout_s
    while not _is_ready(descriptor, msvcrt):
        if time.monotonic() >= deadline:
            return False
        time.sleep(POLL_PERIOD_S)
    return True


def _is_ready(descriptor: int, msvcrt: object) -> bool:
    import os

    if os.isatty(descriptor):
        return bool(msvcrt.kbhit())  # type: ignore[attr-defined]
    handle = msvcrt.get_osfhandle(descriptor)  # type: ignore[attr-defined]
    try:
        return bool(import_module("_winapi").PeekNamedPipe(handle, 0)[0])
    except OSError:  # its end, or a file
        return True
