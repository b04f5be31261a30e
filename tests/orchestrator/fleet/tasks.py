"""What workers of the tests do."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

from protocols import InputError


def double(number: int) -> int:
    """After a moment."""
    time.sleep(0.02)
    return 2 * number


def nothing(_: int) -> None:
    """At once."""


def refuse(number: int) -> int:
    """Raise an error of the project's."""
    raise InputError("tasks", str(number), "is refused")


def stumble(number: int) -> int:
    """Raise an error that is nobody's."""
    raise ZeroDivisionError(f"{number}\nin two lines")


def die(deaths: str, most: int) -> str:
    """Kill the process that does it, as long as it has not done so often enough."""
    with Path(deaths).open("a+") as file:
        file.seek(0)
        if len(file.read()) < most:
            file.write("x")
            file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def leave(numbers: str, seconds: float) -> int:
    """Answer after so long, and kill the process that did so as long afterwards, the first time."""
    time.sleep(seconds)
    with Path(numbers).open("a+") as file:
        file.seek(0)
        first = not file.read()
        file.write("x")
    if first:
        threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGKILL)).start()
    return 7
