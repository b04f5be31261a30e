"""The reference firmware as its user gets it: written out, built, and run on the host or on QEMU's Cortex-M4."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from plugins.wire._firmware import write_firmware
from tests.support.emulator import free_port
from tests.support.processes import wait_until

PATIENT = "-DFB_WATCHDOG_S=0.6f"
"""Both ends share a machine with everything else that runs: three times the patience that a bench needs."""


def tool(name: str) -> str:
    """A program's path; skips the test, with the reason, where it is not installed."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def build(folder: Path, target: str, extra: str = PATIENT) -> Path:
    """Write the firmware to `folder` and make one of its boards; returns the program."""
    tool("arm-none-eabi-gcc" if target == "mps2_an386" else "gcc")
    write_firmware(folder)
    built = subprocess.run([tool("make"), target, f"EXTRA={extra}"], cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return folder / {"host": "fluxbench-host", "mps2_an386": "fluxbench-mps2_an386.elf"}[target]


@dataclass
class Board:
    """A board that runs."""

    process: subprocess.Popen[bytes]
    port: str
    """As the option of the drive `serial`."""
    lamp: Path | None = None
    """A file that says 1 while the gates are on, where there is one."""

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)


@contextmanager
def host_board(program: Path, folder: Path, speed: float = 1.0) -> Iterator[Board]:
    """The firmware as a process, at a pseudo-terminal linked at `folder`/line."""
    line = folder / "line"
    lamp = folder / "lamp"
    with _running([str(program), str(line), str(speed), str(lamp)]) as process:
        wait_until(lambda: line.is_symlink() or process.poll() is not None)
        assert process.poll() is None
        yield Board(process, str(line), lamp)


@contextmanager
def cortex_m4(program: Path) -> Iterator[Board]:
    """The firmware on QEMU's mps2-an386, its UART behind a socket."""
    port = free_port()
    machine = [tool("qemu-system-arm"), "-M", "mps2-an386", "-nographic", "-monitor", "none"]
    serial = ["-serial", f"tcp:127.0.0.1:{port},server=on,wait=off"]
    with _running([*machine, *serial, "-kernel", str(program)]) as process:
        wait_until(lambda: _listens(port) or process.poll() is not None)
        assert process.poll() is None
        yield Board(process, f"socket://127.0.0.1:{port}")


def _listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False


@contextmanager
def _running(words: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    with suppress(OSError):  # a microcontroller shares its time with nobody; not every system allows it
        os.sched_setscheduler(process.pid, os.SCHED_RR, os.sched_param(1))
    try:
        yield process
    finally:
        for number in (signal.SIGCONT, signal.SIGTERM):
            if process.poll() is None:
                process.send_signal(number)
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
