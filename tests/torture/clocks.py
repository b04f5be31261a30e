"""A wall clock that jumps by years while a run is under way."""

from __future__ import annotations

import functools
import json
import os
import random
import shutil
import subprocess
import tempfile
from pathlib import Path

from orchestrator.recording import open_recording
from protocols import PointDone
from tests.support.processes import FLUXBENCH
from tests.support.tiny import STAGES, messages_of, tiny_file

YEAR_S = 31_556_952
SHORT = [*STAGES[:4], STAGES[5]]
"""Six points, no estimates."""
POINTS = 6
COMMANDS = (("resume",), ("report",), ("estimate",))


@functools.cache
def jumping_clock() -> Path:
    """The shared library with the clock, made once in a process."""
    folder = Path(tempfile.mkdtemp(prefix="jumping-clock-"))
    library = folder / "jumping_clock.so"
    source = Path(__file__).parents[1] / "support" / "jumping_clock.c"
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    assert compiler is not None, "no C compiler here"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library


def jumped(rng: random.Random, folder: Path) -> str:
    """The clock jumps forth and back in the middle of a run, and of a command on it: both do what they always do."""
    years = rng.choice((-56, -40, -1, 1, 12, 40, 200, 400))
    run, procedure = folder / "run", tiny_file(folder, stages=SHORT)
    _with_clock(rng, years, "run", procedure, "--out", run, "--quiet")
    assert sum(isinstance(message, PointDone) for message in messages_of(run)) == POINTS
    recording = open_recording(run)
    assert len([recording.load(segment) for segment in recording.segments()]) == POINTS
    command = rng.choice(COMMANDS)
    _with_clock(rng, years, *command, run)
    listed = _with_clock(rng, years, "runs", "--folder", folder, "--json")
    assert [row["outcome"] for row in json.loads(listed)] == ["finished"]
    return "back" if years < 0 else "forth"


def _with_clock(rng: random.Random, years: int, *words: str | Path) -> str:
    jump = {"CLOCK_JUMP_AFTER": str(int(10 ** rng.uniform(0.3, 3.0))), "CLOCK_JUMP_S": str(years * YEAR_S)}
    environment = os.environ | {"LD_PRELOAD": str(jumping_clock())} | jump
    done = subprocess.run(
        [FLUXBENCH, *map(str, words)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=environment,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, f"{years} years, {jump}: {words[0]}: {done.stderr}"
    assert done.stderr.count("\n") <= 1, done.stderr
    return done.stdout
