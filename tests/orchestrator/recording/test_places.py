"""A path that is no run: one line says what it is, and how to find a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.recording import require_recording
from protocols import RecordingError


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder with the run ``first`` and an empty folder, beside a text file."""
    captures = tmp_path / "runs" / "first" / "captures"
    captures.mkdir(parents=True)
    (captures / "hold-000.parquet").touch()
    (tmp_path / "runs" / "first" / "run.json").touch()
    (tmp_path / "runs" / "empty").mkdir()
    (tmp_path / "README.md").touch()
    return tmp_path / "runs"


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("nowhere", "no such directory; expected the directory of a run or recording: `fluxbench runs` lists the runs"),
        ("frist", "no such directory; did you mean {runs}/first?"),
        ("../README.md", "is a file; expected the directory of a run or recording: `fluxbench runs` lists the runs"),
        ("empty", "neither a run nor a recording: it has no run.json and no recording.json"),
        ("", "a folder of runs, not a run; `fluxbench runs --folder {runs}` lists them"),
        ("first/run.json", "is a file of the run or recording {runs}/first; give that directory instead"),
        ("first/captures", "is a folder of the run or recording {runs}/first; give that directory instead"),
        ("first/captures/hold-000.parquet", "is a file of the run or recording {runs}/first"),
        ("first/results", "no such file in {runs}/first"),
    ],
)
def test_what_is_no_run_is_described_with_a_way_to_find_one(runs: Path, name: str, problem: str) -> None:
    with pytest.raises(RecordingError) as caught:
        require_recording(runs / name)
    assert problem.format(runs=runs) in str(caught.value)


def test_a_run_is_accepted(runs: Path) -> None:
    require_recording(runs / "first")
