"""Folders in which results are prepared: those of the living stay, those of the dead go with the next command."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.estimation import staging_folder
from orchestrator.runs import open_any, remove_stale_staging
from tests.support.tiny import run_tiny

STAGE = """
import sys, time
from pathlib import Path
from orchestrator.estimation import staging_folder
with staging_folder(Path(sys.argv[1]), ".estimating-") as folder:
    (folder / "flux_map.nc").write_bytes(b"half")
    print(folder, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def staged(tmp_path: Path) -> tuple[subprocess.Popen[str], Path]:
    """A process that prepares results, and its folder."""
    (tmp_path / "results").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", STAGE, str(tmp_path / "results")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_a_folder_goes_when_its_process_was_killed_and_never_before(
    staged: tuple[subprocess.Popen[str], Path],
) -> None:
    process, folder = staged
    remove_stale_staging(folder.parent)
    assert (folder / "flux_map.nc").is_file()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert folder.is_dir(), "a killed process leaves it"
    remove_stale_staging(folder.parent)
    assert not folder.exists()


def test_links_and_files_of_such_names_stay(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / ".estimating-link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / ".view-file").write_text("mine")
    remove_stale_staging(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == [".estimating-link", ".view-file", "elsewhere"]


def test_whoever_opens_a_run_removes_what_a_kill_has_left_in_it(tmp_path: Path) -> None:
    run = run_tiny(tmp_path, stages=[{"kind": "gates_off", "duration_s": 0.02}]).path
    (run / "results").mkdir(exist_ok=True)
    left = [run / "results" / ".estimating-x", run / ".view-x"]
    for folder in left:
        folder.mkdir()
    with staging_folder(run / "results", ".estimating-") as own:
        open_any(run)
        assert own.is_dir()
    assert not any(folder.exists() for folder in left)
