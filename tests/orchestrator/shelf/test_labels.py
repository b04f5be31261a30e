"""Tags and notes are in the run's own folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orchestrator.shelf import relabel, save_labels
from protocols import InputError, RecordingError, RunLabels
from tests.orchestrator.shelf.example_runs import a_run


def test_labels_are_added_and_removed_and_kept_in_the_folder(tmp_path: Path) -> None:
    folder = a_run(tmp_path / "one", about={"tags": ["cold"], "notes": ["first"]})
    assert relabel(folder) == RunLabels(tags=("cold",), notes=("first",))
    assert not (folder / "labels.json").exists(), "nothing has changed"
    relabel(folder, tags=["returned"], untag=["cold"], notes=["a; b\nc"])
    assert json.loads((folder / "labels.json").read_text()) == {
        "format": "fluxbench-labels",
        "version": 1,
        "tags": ["returned"],
        "notes": ["first", "a; b\nc"],
    }


def test_a_tag_to_remove_has_to_be_there(tmp_path: Path) -> None:
    folder = a_run(tmp_path / "one", about={"tags": ["cold"]})
    with pytest.raises(InputError, match="warm: no such tag to remove; it has cold"):
        relabel(folder, untag=["warm"])


def test_all_labels_may_be_taken_away(tmp_path: Path) -> None:
    folder = a_run(tmp_path / "one", about={"tags": ["cold"]})
    save_labels(folder, RunLabels())
    assert relabel(folder) == RunLabels()


def test_labels_belong_to_a_run(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="neither a run nor a recording"):
        save_labels(tmp_path, RunLabels(tags=("cold",)))


@pytest.mark.parametrize("text", ["{", "[]", '{"format": "fluxbench-labels", "version": 1, "tags": "cold"}'])
def test_damaged_labels_are_one_line(tmp_path: Path, text: str) -> None:
    folder = a_run(tmp_path / "one")
    (folder / "labels.json").write_text(text)
    with pytest.raises(RecordingError, match="labels"):
        relabel(folder, tags=["cold"])
