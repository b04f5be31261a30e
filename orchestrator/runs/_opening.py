"""Whatever holds a recording, opened; and directories that results may go to."""

from __future__ import annotations

import os
from pathlib import Path

from orchestrator.recording import MANIFEST_NAME, Recording, open_recording
from orchestrator.runs._directory import RunDirectory, is_run
from protocols import InputError, RecordingError


def open_any(path: Path, *, keep: bool = False) -> Recording:
    """Open a recording; a run's manifest is made from its journal, which knows best, and with `keep` written too."""
    if path.exists() and not path.is_dir() and path.name != MANIFEST_NAME:
        raise RecordingError(str(path), "", "is a file; expected the directory of a recording or run")
    manifest = path / MANIFEST_NAME
    if manifest.exists() and not manifest.is_file():
        raise RecordingError(str(manifest), "", "is not a plain file")
    if not is_run(path):
        return open_recording(path)
    run = RunDirectory.open(path)
    return Recording(run.path, run.write_manifest() if keep else run.manifest())


def refuse_file(path: Path) -> None:
    """Raise `InputError` where something that is no directory is in the way of one."""
    for place in (path, *path.parents):
        if os.path.lexists(place) and not place.is_dir():
            raise InputError(str(place), "", "is not a directory, and nothing is overwritten: name another place")
