"""`recording.json`: read with errors of one line, written by rename. Captures are not opened here."""

from __future__ import annotations

from pathlib import Path

from orchestrator.formatting.sentences import visible
from orchestrator.recording._files import replace_file
from orchestrator.recording._json import read_json
from protocols import Manifest

MANIFEST_NAME = "recording.json"
_CAPTURES = "captures"


def capture_path(directory: Path, segment_id: str) -> Path:
    """The file of a segment's waveforms in a recording."""
    return directory / _CAPTURES / f"{segment_id}.parquet"


def read_manifest(path: Path) -> Manifest:
    """The validated manifest in the file `path`; raises `RecordingError` naming file and field."""
    return read_json(path, Manifest)


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Replace the manifest of the recording in `directory`; raises `StorageError`."""
    replace_file(directory / MANIFEST_NAME, (visible(manifest.model_dump_json(indent=1)) + "\n").encode())
