"""Converts errors of links (python-can, pyserial, the operating system) to `DriveFault`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from protocols import DriveFault, FaultCause

PROBE_HINT = "; `fluxbench probe` lists the drives on this machine's ports"


@contextmanager
def link_errors(where: str, hint: str = "") -> Iterator[None]:
    """Convert errors of a link's library to `DriveFault` (link_lost) with the link's name, and a hint.

    pyserial's errors are `OSError`, except for those of `termios`; python-can has a
    base class of its own. Both are known only after their import.
    """
    try:
        yield
    except _raised_by_libraries() as error:
        raise DriveFault(FaultCause.LINK_LOST, f"{where}: {_reason(error)}{hint}") from error


def _reason(error: Exception) -> str:
    """The error's first line; pyserial's without the system's error, which it repeats with its number."""
    if isinstance(error, OSError) and error.errno and error.strerror and ": [Errno" in error.strerror:
        return f"{error.strerror.partition(': [Errno')[0]}: {os.strerror(error.errno)}"
    return (str(error) or type(error).__name__).splitlines()[0]


def _raised_by_libraries() -> tuple[type[Exception], ...]:
    can: Any = sys.modules.get("can")
    termios: Any = sys.modules.get("termios")  # not of Windows
    known = (getattr(can, "CanError", None), getattr(termios, "error", None))
    return (OSError, *(error for error in known if error is not None))
