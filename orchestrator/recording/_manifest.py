"""`recording.json`: read with every complaint in one line, written by rename. Captures are not opened here."""

from __future__ import annotations

import json
import math
from pathlib import Path

from pydantic import ValidationError

from orchestrator._validation import first_problem
from orchestrator.recording._files import replace_file
from protocols import Manifest, RecordingError

MANIFEST_NAME = "recording.json"
_CAPTURES = "captures"


def capture_path(directory: Path, segment_id: str) -> Path:
    """Where a segment's waveforms are in a recording."""
    return directory / _CAPTURES / f"{segment_id}.parquet"


def read_manifest(path: Path) -> Manifest:
    """The validated manifest in the file `path`; raises `RecordingError` naming file and field."""
    raw = _read_json(path)
    if not isinstance(raw, dict):
        raise RecordingError(str(path), "", f"expected a JSON object, got {type(raw).__name__}")
    _check_format(path, raw)
    try:
        return Manifest.model_validate(raw)
    except ValidationError as error:
        problem = first_problem(error, Manifest, raw)
        raise RecordingError(str(path), problem.field, problem.text) from None


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Replace the manifest of the recording in `directory`; raises `StorageError`."""
    replace_file(directory / MANIFEST_NAME, (manifest.model_dump_json(indent=1) + "\n").encode())


def _read_json(path: Path) -> object:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise RecordingError(str(path), "", f"not UTF-8 at byte {error.start}") from None
    try:
        return json.loads(text, parse_constant=_refuse, parse_float=_finite)
    except json.JSONDecodeError as error:
        raise RecordingError(f"{path}:{error.lineno}", "", f"broken JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(path), "", f"broken JSON: {error}") from None


def _check_format(path: Path, raw: dict[str, object]) -> None:
    if raw.get("format") != "fluxbench-recording":
        raise RecordingError(str(path), "format", f"expected 'fluxbench-recording', got {raw.get('format')!r}"[:120])
    if raw.get("version") != 1:
        raise RecordingError(str(path), "version", f"version 1 can be read, got {raw.get('version')!r}"[:120])


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a number here")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large a number")
    return value
