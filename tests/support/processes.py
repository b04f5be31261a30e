"""The command line, as a process of its own or as a call."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

from orchestrator.interface.cli._running import run_app
from tests.support.forking import ForkedCommand

FLUXBENCH = str(Path(sys.executable).with_name("fluxbench"))


def called(*words: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process, for what it prints and its exit code: spares a second of imports."""
    arguments = [*map(str, words)]
    with io.StringIO() as out, io.StringIO() as err:
        with chdir(cwd or Path.cwd()), redirect_stdout(out), redirect_stderr(err):
            code = run_app(arguments)
        return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def start_fluxbench(*words: str | Path, cwd: Path | None = None) -> ForkedCommand:
    """Start a command as a process of its own, which has imported everything, and let it run."""
    return ForkedCommand([*map(str, words)], cwd)


def start_afresh(*words: str | Path) -> subprocess.Popen[str]:
    """Start a command as a user does: from nothing."""
    return subprocess.Popen(
        [FLUXBENCH, *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_until(condition: Callable[[], bool], timeout_s: float = 120.0) -> None:
    """Look every few milliseconds until it is so, and less often where to look takes long."""
    deadline = time.monotonic() + timeout_s
    while True:
        begun = time.monotonic()
        if condition():
            return
        if begun > deadline:
            raise TimeoutError("it never came to be so")
        time.sleep(max(0.005, 3.0 * (time.monotonic() - begun)))
