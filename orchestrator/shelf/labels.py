"""Tags and notes of a run: ``labels.json`` in its folder, or those with which it was started."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from orchestrator.recording import read_json, write_json
from orchestrator.runs import RunDirectory
from protocols import About, InputError, RunLabels

LABELS_NAME = "labels.json"


def load_labels(folder: Path, about: About) -> RunLabels:
    """The labels in a run's folder, or those of its procedure; raises `RecordingError` for a damaged file."""
    file = folder / LABELS_NAME
    return (
        read_json(file, RunLabels) if file.exists() else RunLabels.model_construct(tags=about.tags, notes=about.notes)
    )


def save_labels(folder: Path, labels: RunLabels) -> None:
    """Replace the labels of a run; raises `RecordingError` where there is no run, and `StorageError`."""
    write_json(RunDirectory.open(folder).path / LABELS_NAME, labels)


def relabel(
    folder: Path, *, tags: Iterable[str] = (), untag: Iterable[str] = (), notes: Iterable[str] = ()
) -> RunLabels:
    """Add tags and notes to a run, and remove tags; returns its labels, which are saved where they changed.

    Raises
    ------
    RecordingError
        Where there is no run, or its labels are damaged.
    InputError
        Where a tag to remove is none of the run's.
    StorageError
        Where they cannot be written.
    """
    before = load_labels(folder, RunDirectory.open(folder).record.procedure.about)
    removed = set(untag)
    for tag in removed - set(before.tags):
        raise InputError(str(folder), tag, f"no such tag to remove; it has {', '.join(before.tags) or 'none'}")
    kept = dict.fromkeys((*(tag for tag in before.tags if tag not in removed), *tags))
    labels = RunLabels(tags=tuple(kept), notes=(*before.notes, *notes))
    if labels != before:
        save_labels(folder, labels)
    return labels
