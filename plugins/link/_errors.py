"""The one place where errors of links (python-can, pyserial, the operating system) become the project's own."""

from __future__ import annotations

import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from protocols import DriveFault, FaultCause


@contextmanager
def link_errors(where: str) -> Iterator[None]:
    """Turn whatever a link's library raises into `DriveFault` (link_lost) that names the link.

    pyserial's errors are `OSError`, except for those that `termios` lets through; python-can has a
    base of its own, which is known only once it was imported.
    """
    try:
        yield
    except _raised_by_libraries() as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise DriveFault(FaultCause.LINK_LOST, f"{where}: {reason}") from error


def _raised_by_libraries() -> tuple[type[Exception], ...]:
    can: Any = sys.modules.get("can")
    return (OSError, termios.error, *(() if can is None else (can.CanError,)))
