"""Opening of runs and recordings, and checks of directories for results."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from orchestrator.recording import MANIFEST_NAME, Recording, open_recording, require_recording
from orchestrator.runs._directory import RunDirectory, is_private, is_run
from orchestrator.runs._staging import remove_stale_staging
from protocols import InputError, RecordingError


def open_any(path: Path, *, keep: bool = False) -> Recording:
    """Open a recording or run; a run's manifest comes from its journal, and with `keep` it is written too."""
    require_recording(path)
    manifest = path / MANIFEST_NAME
    if manifest.exists() and not manifest.is_file():
        raise RecordingError(str(manifest), "", "is not a plain file")
    if not is_run(path):
        return open_recording(path)
    run = RunDirectory.open(path)
    for folder in (run.path, run.path / "results"):
        remove_stale_staging(folder)
    return Recording(run.path, run.write_manifest() if keep else run.manifest())


def without_private(paths: Sequence[Path]) -> list[Path]:
    """Several paths without the private folders beside runs, which the shell's ``runs/*`` includes; one stays."""
    return [path for path in paths if not is_private(path)] or list(paths[:1])


def refuse_file(path: Path, *, writes: bool = True) -> None:
    """Raise `InputError` where a path cannot be a folder of results: before work whose result would be lost.

    It or one of its parents is a file; or, where the folder is to be written, the nearest that exists is read-only.
    """
    places = (path, *path.parents)
    for place in places:
        if os.path.lexists(place) and not place.is_dir():
            raise InputError(str(place), "", "is not a directory and is not overwritten: name another place")
    nearest = next((place for place in places if place.is_dir()), None)
    if writes and nearest is not None and not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(str(nearest), "", "the folder is read-only for you: name another place, with --out")


def require_file_place(path: Path, option: str) -> None:
    """Raise `InputError` where no file can be written to a path: before work whose result would be lost."""
    if path.is_dir():
        raise InputError(option, str(path), "is a folder; expected a file to write")
    if not path.parent.is_dir():
        raise InputError(option, str(path), f"no such folder: {path.parent}")
