"""What `run` and `diagnose` print while they work, on a real terminal and into a pipe: a line at once, then more."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.tiny import STAGES, tiny_file

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"
MAX_CPU_S = 0.5
"""Of the first line; measured: 0.15 s."""
TIMEOUT_S = 60.0
WAYS = pytest.mark.parametrize("terminal", [True, False], ids=["terminal", "pipe"])


@dataclass
class Watched:
    """A command that runs, and what it has printed so far on both outputs."""

    process: subprocess.Popen[bytes]
    output: int
    text: str = ""

    def read_until(self, pattern: str) -> float:
        """Wait for this; returns the CPU time that the command has taken [s]."""
        while not re.search(pattern, self.text):
            assert self._read(), f"it ended without: {self.text}"
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def finish(self) -> int:
        """Read to the end; returns the exit code."""
        while self._read():
            pass
        return self.process.wait(TIMEOUT_S)

    def _read(self) -> bool:
        """Whether there was more to read."""
        try:
            data = os.read(self.output, 1 << 16)
        except OSError:  # a terminal that is open no more
            return False
        self.text += data.decode(errors="replace")
        return bool(data)

    def is_running(self) -> bool:
        return self.process.poll() is None


@contextmanager
def watch(*words: str | Path, terminal: bool) -> Iterator[Watched]:
    """Start a command as a user does, from nothing; what is left of it at the end is killed."""
    reading, writing = os.openpty() if terminal else os.pipe()
    command = [sys.executable, "-m", "fluxbench", *map(str, words)]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=writing, stderr=writing)
    os.close(writing)
    try:
        yield Watched(process, reading)
    finally:
        process.kill()
        process.wait()
        os.close(reading)


@WAYS
def test_the_first_line_of_a_diagnosis_is_there_before_it_works(terminal: bool, tmp_path: Path) -> None:
    recording = Path(shutil.copytree(DATA, tmp_path / "recording"))
    with watch("diagnose", recording, terminal=terminal) as command:
        cpu_s = command.read_until(r"\n")
        assert command.is_running()
    assert command.text.splitlines()[0] == f"reading {recording}"
    assert cpu_s < MAX_CPU_S


@pytest.mark.slow
@WAYS
def test_a_diagnosis_says_how_far_it_is_before_its_end(terminal: bool, tmp_path: Path) -> None:
    recording = Path(shutil.copytree(DATA, tmp_path / "recording"))
    with watch("diagnose", recording, terminal=terminal) as command:
        if terminal:
            command.read_until(r"\n +\d+ s  \S.*\n")  # the step, and the time since the start
        command.read_until(r"so far: .*\n")
        assert command.is_running()
        assert "chi2 per degree" not in command.text, "the report was there before"
        assert command.finish() == 0
    assert "chi2 per degree" in command.text


@pytest.mark.slow
@WAYS
def test_a_run_says_how_far_it_is_before_its_end(terminal: bool, tmp_path: Path) -> None:
    procedure = tiny_file(tmp_path, stages=STAGES)
    with watch("run", procedure, "--out", tmp_path / "run", terminal=terminal) as command:
        command.read_until(r"stage 1 of 9")
        assert command.is_running()
        command.read_until("stage 6 of 9" if terminal else r"\d+%  \d+ of 19 points")
        assert command.is_running()
        assert "flux map" not in command.text, "the result was there before"
        assert command.finish() == 0
    assert "flux map" in command.text
