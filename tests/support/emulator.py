"""The emulated drive as a process of its own, and what its log says."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.forking import ForkedCommand
from tests.support.processes import start_fluxbench, wait_until


@dataclass
class Emulator:
    """A running emulator."""

    process: ForkedCommand
    log: Path

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """What it logged, of these kinds (all, where none is named); an unfinished last line is left out."""
        lines = self.log.read_text().splitlines(keepends=True) if self.log.exists() else []
        found: list[dict[str, Any]] = [json.loads(line) for line in lines if line.endswith("\n")]
        return [event for event in found if not kinds or event["event"] in kinds]

    def is_energised(self, time_s: float = math.inf) -> bool:
        """Whether its power stage was on at an instant of the monotonic clock; now, where none is named."""
        turns = [event for event in self.events("armed", "disarmed", "safe") if event["time_s"] <= time_s]
        return bool(turns) and turns[-1]["event"] == "armed"

    def send(self, number: signal.Signals) -> None:
        """A signal to it alone."""
        os.kill(self.process.pid, number)


def with_interlocks(switches: Path) -> tuple[str, ...]:
    """Words for two inputs, of which those are open whose names stand in this file."""
    return ("--set", "interlocks=[door, cover]", "--open-interlocks", str(switches))


def free_port() -> int:
    """A UDP port that nobody has, for a multicast bus of one's own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def emulator(folder: Path, *words: str, link: str = "--serial") -> Iterator[Emulator]:
    """An emulated drive; its line is linked at `folder`/line, or joins the bus that `words` name."""
    log = folder / "emulator.jsonl"
    words = (link, str(folder / "line"), *words) if link == "--serial" else (link, *words)
    process = start_fluxbench("emulate", *words, "--log", log)
    running = Emulator(process, log)
    try:
        wait_until(lambda: bool(running.events("started")) or process.poll() is not None)
        assert process.poll() is None, process.communicate()[1]
        yield running
    finally:
        for number in (signal.SIGCONT, signal.SIGTERM):
            if process.poll() is None:
                process.send_signal(number)
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
