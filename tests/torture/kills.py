"""`commission` and `fleet`, killed at random instants and started again."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import psutil

from orchestrator.fleet import read_table
from orchestrator.recording import open_recording
from orchestrator.runs import is_run
from protocols import PointDone
from tests.orchestrator.fleet.small import small_recordings
from tests.support.processes import FLUXBENCH, wait_until
from tests.support.tiny import messages_of

SAFE = "I have made the bench safe"
RECORDINGS = 6


def commissioning_killed(rng: random.Random, folder: Path) -> str:
    """A commissioning to an accuracy is killed up to twice; resumed, it ends with a map, and every point once."""
    run = folder / "run"
    words: tuple[str | Path, ...] = ("commission", "--until", "5%", "--out", run, "--unattended", SAFE)
    kills = 0
    for _ in range(rng.randint(1, 2)):
        if _killed_after(rng.uniform(0.5, 12.0), words) == 0:
            break
        kills += 1
        if is_run(run):
            words = ("resume", run, "--unattended", SAFE)
    done = _to_its_end(words)
    assert done.returncode == 0, done.stderr
    points = [message.id for message in messages_of(run) if isinstance(message, PointDone)]
    assert len(points) == len(set(points)) > 0
    recording = open_recording(run)
    assert [segment.id for segment in recording.segments()] == points
    for segment in recording.segments():
        recording.load(segment)
    assert (run / "results" / "flux_map.nc").is_file()
    _require_no_leftovers(run)
    return f"killed {kills} times"


def fleet_killed(rng: random.Random, folder: Path) -> str:
    """A fleet's job is killed up to three times, the workers left to themselves; at last each recording has one row."""
    bench, table = folder / "bench", folder / "table"
    small_recordings(bench, RECORDINGS)
    words: tuple[str | Path, ...] = ("fleet", "run", bench, "--out", table, "--jobs", "2")
    kills = 0
    for _ in range(rng.randint(1, 3)):
        if _killed_after(rng.uniform(0.5, 8.0), words) == 0:
            break
        kills += 1
    done = _to_its_end(words)
    assert done.returncode == 0, done.stderr
    rows = read_table(table)
    assert Counter(Path(row.source).name for row in rows) == Counter(f"r{k:03d}" for k in range(RECORDINGS))
    assert [row.failed for row in rows] == [None] * RECORDINGS
    _require_no_leftovers(table)
    wait_until(lambda: not _workers_of(folder), 60.0)
    return f"killed {kills} times"


def _killed_after(seconds: float, words: tuple[str | Path, ...]) -> int | None:
    """Kill a command after that time; its exit code where it ended before."""
    process = subprocess.Popen(
        [FLUXBENCH, *map(str, words)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=_folder_of(words),
    )
    end_s = time.monotonic() + seconds
    while process.poll() is None and time.monotonic() < end_s:
        time.sleep(0.01)
    if process.poll() is None:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return None
    return process.returncode


def _to_its_end(words: tuple[str | Path, ...]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [FLUXBENCH, *map(str, words)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=_folder_of(words),
    )


def _folder_of(words: tuple[str | Path, ...]) -> Path:
    """The attack's folder, in which the workers can be recognised."""
    return next(word for word in words if isinstance(word, Path)).parent


def _workers_of(folder: Path) -> list[int]:
    found = []
    for process in psutil.process_iter():
        try:
            if process.pid != os.getpid() and Path(process.cwd()).is_relative_to(folder):
                found.append(process.pid)
        except (psutil.Error, OSError):
            continue
    return found


def _require_no_leftovers(folder: Path) -> None:
    left = [path for path in folder.rglob(".*") if path.name != ".lock"]
    assert not left, left
