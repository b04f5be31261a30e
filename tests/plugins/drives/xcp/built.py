"""An ECU of our own, in C: built from what `fluxbench xcp` writes, run as a process with a motor in software."""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import pytest

from plugins.drives.xcp import XcpOptions
from plugins.drives.xcp._command import write_routine
from plugins.wire._firmware import write_firmware
from tests.support.emulator import free_port
from tests.support.processes import wait_until

SOURCES = Path(__file__).parent / "ecu"
WATCHDOG_TICKS = 6000
"""Both ends share a machine with everything else that runs: twice the patience that a bench needs."""
TIMEOUT_S = 10.0
"""The same for an answer."""
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Werror")


@dataclass(frozen=True)
class Program:
    """A built ECU, and where the linker has put `fluxbench`."""

    path: Path
    address: int


@dataclass
class Ecu:
    """One that runs."""

    process: subprocess.Popen[bytes]
    options: XcpOptions
    lamp: Path

    @property
    def gates_are_on(self) -> bool:
        return self.lamp.read_text() == "1"

    def lose_a_row(self) -> None:
        self.process.send_signal(signal.SIGUSR1)


def build(folder: Path, watchdog_ticks: int = WATCHDOG_TICKS) -> Program:
    """Write the routine and the motor out and compile them with the slave; skips where there is no compiler."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    write_routine(folder / "routine")
    config = folder / "routine" / "fluxbench_config.h"
    config.write_text(config.read_text().replace("TICKS 3000u", f"TICKS {watchdog_ticks}u"))
    write_firmware(folder / "firmware")
    motor = folder / "firmware" / "boards" / "motor"
    units = [SOURCES / "ecu.c", SOURCES / "xcp.c", folder / "routine" / "fluxbench_xcp.c", motor / "motor.c"]
    program = folder / "ecu"
    # XCP's addresses have 32 bits: the program stands at a fixed place below 4 GB.
    flags = ["-std=gnu99", "-O2", "-no-pie", *WARNINGS, f"-I{folder / 'routine'}", f"-I{motor}"]
    subprocess.run(["gcc", *flags, *map(str, units), "-lm", "-o", str(program)], check=True)
    symbols = subprocess.run(["nm", str(program)], check=True, capture_output=True, text=True).stdout.splitlines()
    address = next(line.split()[0] for line in symbols if line.endswith(" fluxbench"))
    return Program(program, int(address, 16))


def _has_ended_or_lights(process: subprocess.Popen[bytes], lamp: Path) -> bool:
    return process.poll() is not None or (lamp.exists() and lamp.read_text() == "0")


def _listening(program: Program, lamp: Path, protocol: str) -> tuple[subprocess.Popen[bytes], int]:
    """The process and its port; another one, where something else took the port in the meantime."""
    for _ in range(3):
        port = free_port()
        process = subprocess.Popen([str(program.path), protocol, str(port), str(lamp)])
        wait_until(partial(_has_ended_or_lights, process, lamp))
        if process.poll() is None:
            return process, port
    raise AssertionError(f"{program.path} does not listen")


@contextmanager
def running(program: Program, folder: Path, protocol: Literal["udp", "tcp"] = "tcp") -> Iterator[Ecu]:
    """The ECU as a process, listening at the loopback address."""
    lamp = folder / "lamp"
    process, port = _listening(program, lamp, protocol)
    options = XcpOptions(port=port, protocol=protocol, address=program.address, timeout_s=TIMEOUT_S)
    try:
        yield Ecu(process, options, lamp)
    finally:
        for number in (signal.SIGCONT, signal.SIGTERM):
            with suppress(ProcessLookupError):
                process.send_signal(number)
        process.wait(timeout=10)
