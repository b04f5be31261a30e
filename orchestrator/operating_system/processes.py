"""Processes: cores, groups that a terminal's keys do not reach, and programs that outlive this one."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any


def available_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def own_group() -> dict[str, Any]:
    """Arguments for `subprocess` that keep a terminal's Ctrl-C and Ctrl-Z away from a process."""
    if os.name == "nt":
        return {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0x200)}
    return {"start_new_session": True}


def open_process(words: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
    """`subprocess.Popen` with unbuffered pipes that `asyncio` can read and write; raises `OSError`."""
    try:
        popen: type[subprocess.Popen[bytes]] = import_module("asyncio.windows_utils").Popen
    except ImportError:
        popen = subprocess.Popen
    return popen(list(words), bufsize=0, **options)


def interrupt(process: subprocess.Popen[bytes]) -> None:
    """Ask a process of its `own_group` to end as Ctrl-C does; Windows can only send Ctrl-Break to it."""
    process.send_signal(getattr(signal, "CTRL_BREAK_EVENT", signal.SIGINT))


class LastingProcess(subprocess.Popen[bytes]):
    """A silent program in its own group that goes on when this process ends.

    Parameters
    ----------
    words : sequence of str
        Program and arguments.
    extra : mapping, optional
        Additions to the environment.

    Raises `OSError` where it cannot be started.
    """

    def __init__(self, words: Sequence[str], extra: Mapping[str, str] | None = None) -> None:
        nothing = subprocess.DEVNULL
        environment = {**os.environ, **(extra or {})}
        super().__init__(list(words), stdin=nothing, stdout=nothing, stderr=nothing, env=environment, **own_group())

    def __del__(self, *_: Any) -> None:
        """Do not warn that it still runs."""

    @property
    def has_ended(self) -> bool:
        return self.poll() is not None

    def stop(self, timeout_s: float = 3.0) -> None:
        """Ask it to end, and end it after the timeout."""
        self.terminate()
        try:
            self.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()
