"""Converts errors of links (python-can, pyserial, the operating system) to `DriveFault`."""

from __future__ import annotations

import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from protocols import DriveFault, FaultCause


@contextmanager
def link_errors(where: str) -> Iterator[None]:
    """Convert errors of a link's library to `DriveFault` (link_lost) with the link's name.

    pyserial's errors are `OSError`, except for those of `termios`; python-can has a
    base class of its own, which is known only after its import.
    """
    try:
        yield
    except _raised_by_libraries() as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise DriveFault(FaultCause.LINK_LOST, f"{where}: {reason}") from error


def _raised_by_libraries() -> tuple[type[Exception], ...]:
    can: Any = sys.modules.get("can")
    return (OSError, termios.error, *(() if can is None else (can.CanError,)))
