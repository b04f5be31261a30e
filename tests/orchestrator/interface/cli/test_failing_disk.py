"""A disk that fails at any call of a run: it ends safely, nothing measured is lost, and resuming finishes it."""

from __future__ import annotations

import atexit
import errno
import functools
import random
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from orchestrator.recording import open_recording
from orchestrator.runs import is_run
from plugins.streams.report._collect import collect
from protocols import PointDone
from tests.support.cases import few
from tests.support.forking import ForkedCommand
from tests.support.processes import called
from tests.support.tiny import STAGES, messages_of, tiny_file

SHORT = [*STAGES[:4], STAGES[5]]
"""Six points, no estimates."""
POINTS = ["gates_off-000", "alignment-000", *(f"resistance-{k:03d}" for k in range(4))]
CALLS = ("write", "fsync", "fdatasync", "rename", "open")
DISARMED = "current ramped down, drive disarmed"


@pytest.fixture(scope="session")
def failing_disk() -> Path:
    """The shared library that makes calls fail."""
    return compiled()


@functools.cache
def compiled() -> Path:
    """The same, made once in a process."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler here: the disk that fails is a shared library, preloaded")
    folder = tempfile.TemporaryDirectory(prefix="failing-disk-")
    atexit.register(folder.cleanup)
    library = Path(folder.name) / "failing_disk.so"
    source = Path(__file__).parents[3] / "support" / "failing_disk.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return library


def ends_safely_and_resumes(folder: Path, library: Path, call: str, nth: int, error: int, once: bool) -> int:
    """Run on that disk, then resume on a good one until every point is there once; returns the run's exit code."""
    run = folder / "run"
    fault = {"FAULT_CALL": call, "FAULT_BELOW": f"{run}/", "FAULT_NTH": str(nth), "FAULT_ERRNO": str(error)}
    fault |= {"FAULT_ONCE": "1"} if once else {}
    words = ["run", str(tiny_file(folder, stages=SHORT)), "--out", str(run), "--log", "json"]
    command = ForkedCommand(words, preload=library, environment=fault)
    shown, message = command.communicate(timeout=60)
    assert command.returncode in (0, 3) or (command.returncode == 2 and not run.exists()), message
    assert "Traceback" not in message
    if command.returncode:
        assert message.removeprefix(f"loading {words[1]}\n").count("\n") == 1, message
        assert "cannot be" in message
    if '"target":"aligning"' in shown.replace(" ", ""):  # it was armed
        assert DISARMED in shown
    if not is_run(run):  # it failed before anything was measured, and left nothing behind
        assert not run.exists()
        return command.returncode
    if command.returncode == 3:
        resumed = called("resume", run, "--quiet")
        assert resumed.returncode == 0, resumed.stderr
    assert [message.id for message in messages_of(run) if isinstance(message, PointDone)] == POINTS
    recording = open_recording(run)
    assert [segment.id for segment in recording.segments()] == POINTS
    for segment in recording.segments():
        recording.load(segment)
    assert not list(run.rglob("*.partial"))
    return command.returncode


@few(
    "call, nth, error, once",
    [
        ("write", 25, errno.ENOSPC, False),
        ("fdatasync", 9, errno.EIO, True),  # in the middle of a change of state
        ("open", 25, errno.EIO, False),  # between the last point and the manifest
        pytest.param("fdatasync", 6, errno.ENOSPC, False, marks=pytest.mark.slow),
        pytest.param("fsync", 7, errno.EIO, True, marks=pytest.mark.slow),
        pytest.param("rename", 3, errno.EIO, True, marks=pytest.mark.slow),
    ],
)
def test_a_run_on_a_failing_disk_ends_safely_and_can_be_resumed(
    tmp_path: Path, failing_disk: Path, call: str, nth: int, error: int, once: bool
) -> None:
    assert ends_safely_and_resumes(tmp_path, failing_disk, call, nth, error, once) == 3


def test_a_view_that_cannot_be_written_costs_the_run_one_line(tmp_path: Path, failing_disk: Path) -> None:
    run = tmp_path / "run"
    fault = {"FAULT_CALL": "write", "FAULT_BELOW": str(run / "view.rrd"), "FAULT_NTH": "2", "FAULT_ERRNO": "28"}
    words = ["run", str(tiny_file(tmp_path, stages=SHORT[:1])), "--out", str(run), "--quiet"]
    command = ForkedCommand(words, preload=failing_disk, environment=fault)
    shown, message = command.communicate(timeout=40)
    assert (command.returncode, shown, message.count("\n")) == (0, "", 1), message
    assert "stream rerun" in message
    assert "view.rrd: cannot be written: No space left on device" in message
    assert message.split("fluxbench: ")[1].strip() in collect(run).problems[0]


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS)
def test_whichever_call_fails_every_point_is_there_once(tmp_path: Path, failing_disk: Path, call: str) -> None:
    rng = random.Random(call)
    failed = 0
    for nth in [1, 2, 3, *rng.sample(range(4, 60), 9)]:
        for once in (True, False):
            folder = tmp_path / f"{nth}-{once}"
            folder.mkdir()
            error = rng.choice((errno.EIO, errno.ENOSPC))
            failed += ends_safely_and_resumes(folder, failing_disk, call, nth, error, once) == 3
    assert failed >= 6
