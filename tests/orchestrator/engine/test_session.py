"""What a run gets ready before anything is energised."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from plugins.drives.simulated import SimulatedDrive
from protocols import StorageError
from tests.support.tiny import run_tiny

ROOT = Path(__file__).parents[3]
WATCHED = """
import sys
from pathlib import Path
from orchestrator.engine import AbsentOperator, RunServices, Interrupts, _session, start_run
from plugins.drives.simulated import SimulatedDrive
from tests.support.tiny import STAGES, tiny_procedure

_session.STREAM_START_TIMEOUT_S = 200.0  # it is waited for, however long a busy machine takes
armed = []
late = set()

def arm(self, limits, arm=SimulatedDrive.arm):
    arm(self, limits)
    armed.append(True)

def disarm(self, disarm=SimulatedDrive.disarm):
    armed.clear()
    disarm(self)

def watch(event, arguments):
    if armed and event == "import":
        late.add(arguments[0].partition(".")[0])
    elif armed and event == "open" and str(arguments[0]).endswith((".nbi", ".nbc")):
        late.add(Path(arguments[0]).name.partition("-")[0])

SimulatedDrive.arm, SimulatedDrive.disarm = arm, disarm
sys.addaudithook(watch)
folder = Path(sys.argv[1])
stages = [stage for stage in STAGES if stage["kind"] in ("gates_off", "resistance", "injection")]
services = RunServices(AbsentOperator(), Interrupts(), {name: {} for name in sys.argv[2:]})
result = start_run(tiny_procedure(folder, stages=stages), folder / "run", services)
assert result.outcome.ending == "finished", result.outcome
print(*sorted(late))
"""


@pytest.mark.parametrize("stream", ["rerun"])
def test_nothing_is_loaded_while_the_drive_is_armed(stream: str, tmp_path: Path) -> None:
    """A heartbeat waits for whoever loads a library or a kernel, and the drive's dead man does not wait for it."""
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(tmp_path), stream], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of a hundred kilobytes."""
    disk = tmp_path / "disk"
    disk.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=100k", "tmpfs", str(disk)], capture_output=True)
    if made.returncode:
        pytest.skip("no disk can be mounted here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_run_that_the_disk_has_no_room_for_is_refused_before_anything_is_energised(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    armed: list[object] = []
    monkeypatch.setattr(SimulatedDrive, "arm", lambda self, limits: armed.append(limits))
    with pytest.raises(StorageError, match=r"needs some \d+ MB, and 0 MB are free; nothing was energised"):
        run_tiny(small_disk)
    assert not armed
    assert [left.name for left in small_disk.iterdir()] == ["tiny.yaml"]
