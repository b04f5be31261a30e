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

INTERLOCKS = ("door", "cover")
"""Of boards that are built with FB_HAS_INTERLOCKS."""
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
    switches: Path | None = None
    """A file for the digit whose bits are the interlock inputs that are open."""
    side: socket.socket | None = None
    """A line that stays open, in place of both files: switches outwards, the lamp inwards."""
    shown: bytes = b"0"

    @property
    def is_on(self) -> bool:
        """Whether the lamp says that the gates are on."""
        if self.side is None:
            assert self.lamp is not None
            return self.lamp.read_text() == "1"
        with suppress(BlockingIOError):
            while data := self.side.recv(64, socket.MSG_DONTWAIT):
                self.shown = data[-1:]
        return self.shown == b"1"

    def open_interlocks(self, names: tuple[str, ...]) -> None:
        """Open these inputs, and close all others."""
        digit = str(sum(1 << INTERLOCKS.index(name) for name in names))
        if self.side is not None:
            self.side.sendall(digit.encode())
        else:
            assert self.switches is not None
            self.switches.write_text(digit)

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)


@contextmanager
def host_board(program: Path, folder: Path, speed: float = 1.0) -> Iterator[Board]:
    """The firmware as a process, at a pseudo-terminal linked at `folder`/line."""
    line = folder / "line"
    lamp, switches = folder / "lamp", folder / "switches"
    with _running([str(program), str(line), str(speed), str(lamp), str(switches)]) as process:
        wait_until(lambda: line.is_symlink() or process.poll() is not None)
        assert process.poll() is None
        yield Board(process, str(line), lamp, switches)


@contextmanager
def cortex_m4(program: Path, folder: Path) -> Iterator[Board]:
    """The firmware on QEMU's mps2-an386, its UART behind a socket, and its lamp and switches behind another one."""
    port = free_port()
    machine = [tool("qemu-system-arm"), "-M", "mps2-an386", "-nographic", "-monitor", "none"]
    side = folder / "side"
    serial = ["-serial", f"tcp:127.0.0.1:{port},server=on,wait=off", "-serial", f"unix:{side},server=on,wait=off"]
    with _running([*machine, *serial, "-kernel", str(program)]) as process:
        wait_until(lambda: _listens(port) or process.poll() is not None)
        assert process.poll() is None
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.connect(str(side))
            yield Board(process, f"socket://127.0.0.1:{port}", side=line)


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
