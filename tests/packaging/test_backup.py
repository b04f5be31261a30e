"""A folder of runs goes into an archive and back unchanged; nothing half written stays, and nothing is overwritten."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.operating_system.locks import LOCK_NAME, locked_file

ROOT = Path(__file__).parents[2]


def called(*words: str | Path, max_bytes: int = resource.RLIM_INFINITY) -> subprocess.CompletedProcess[str]:
    """The command; no file may be longer than `max_bytes`, as on a disk that is full then."""
    return subprocess.run(
        [sys.executable, str(ROOT / "packaging" / "backup.py"), *map(str, words)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, max_bytes)),
        capture_output=True,
        text=True,
        check=False,
    )


def content(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two runs, one with a private folder."""
    folder = tmp_path / "runs"
    for name in ("first", "first.sealed", "second"):
        (folder / name / "captures").mkdir(parents=True)
        (folder / name / LOCK_NAME).touch()
        (folder / name / "captures" / "injection-0.parquet").write_bytes(os.urandom(200_000))
    return folder


def test_runs_come_back_as_they_were(runs: Path, tmp_path: Path) -> None:
    assert called("save", runs, tmp_path / "runs.tar.gz").returncode == 0
    assert called("restore", tmp_path / "runs.tar.gz", tmp_path / "back").returncode == 0
    assert content(tmp_path / "back") == content(runs)


def test_a_run_that_is_under_way_is_left_out_with_its_private_folder(runs: Path, tmp_path: Path) -> None:
    with locked_file(runs / "first" / LOCK_NAME):
        done = called("save", runs, tmp_path / "runs.tar.gz")
    assert (done.returncode, done.stderr) == (1, "first: left out\nfirst.sealed: left out\n")
    called("restore", tmp_path / "runs.tar.gz", tmp_path / "back")
    assert [run.name for run in (tmp_path / "back").iterdir()] == ["second"]


def test_a_run_that_is_there_is_not_overwritten(runs: Path, tmp_path: Path) -> None:
    called("save", runs, tmp_path / "runs.tar.gz")
    (runs / "first" / "note").write_text("mine")
    (runs / "second").rename(tmp_path / "away")
    done = called("restore", tmp_path / "runs.tar.gz", runs)
    assert (done.returncode, done.stderr) == (1, "first: left out\nfirst.sealed: left out\n")
    assert (runs / "first" / "note").read_text() == "mine"
    assert content(runs / "second") == content(tmp_path / "away")


def test_a_full_disk_leaves_the_archive_before_and_no_half_one(runs: Path, tmp_path: Path) -> None:
    archive = tmp_path / "runs.tar.gz"
    archive.write_bytes(b"yesterday's")
    done = called("save", runs, archive, max_bytes=300_000)
    assert done.returncode == 2
    assert "File too large" in done.stderr
    assert archive.read_bytes() == b"yesterday's"
    assert sorted(left.name for left in tmp_path.iterdir()) == ["runs", "runs.tar.gz"]


def test_a_full_disk_leaves_no_half_run(runs: Path, tmp_path: Path) -> None:
    archive = tmp_path / "runs.tar.gz"
    called("save", runs, archive)
    assert called("restore", archive, tmp_path / "back", max_bytes=100_000).returncode == 2
    assert list((tmp_path / "back").iterdir()) == []


@pytest.mark.parametrize("torn", [False, True])
def test_an_archive_that_is_torn_or_none_is_refused_in_one_line(torn: bool, runs: Path, tmp_path: Path) -> None:
    archive = tmp_path / "runs.tar.gz"
    called("save", runs, archive)
    archive.write_bytes(archive.read_bytes()[:-100_000] if torn else b"no archive")
    done = called("restore", archive, tmp_path / "back")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert list((tmp_path / "back").iterdir()) == []
