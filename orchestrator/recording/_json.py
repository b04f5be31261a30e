"""`recording.json` and `model.json`: read with errors of one line (file, field, expected value), written by rename."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from orchestrator.formatting.sentences import visible
from orchestrator.recording._files import replace_file
from orchestrator.validation.json_text import parse_json
from orchestrator.validation.messages import first_problem
from orchestrator.validation.plain_files import MAX_FILE_SIZES, read_text
from protocols import Manifest, MotorModel, RecordingError, StorageError

MANIFEST_NAME, MODEL_NAME = "recording.json", "model.json"
_Model = TypeVar("_Model", bound=BaseModel)


def read_manifest(path: Path) -> Manifest:
    """The validated manifest in the file `path`; raises `RecordingError` naming file and field."""
    return read_json(path, Manifest)


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Replace the manifest of the recording in `directory`; raises `StorageError`."""
    write_json(directory / MANIFEST_NAME, manifest)


def has_model(directory: Path) -> bool:
    """Whether a recording or run has a `model.json`."""
    return (directory / MODEL_NAME).is_file()


def read_model(path: Path) -> MotorModel:
    """The model in a file, or in the `model.json` of a directory.

    Raises
    ------
    RecordingError
        Where there is none, or a field is wrong.
    """
    file = path / MODEL_NAME if path.is_dir() else path
    return read_json(file, MotorModel, older="`fluxbench diagnose` writes it again")


def write_model(directory: Path, model: MotorModel) -> None:
    """Replace the `model.json` of a directory, which is created if missing; raises `StorageError`."""
    path = directory / MODEL_NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_json(path, model)
    except (OSError, StorageError) as error:
        raise StorageError(f"{path} was not written: {error}") from None


def write_json(path: Path, model: BaseModel) -> None:
    """Replace a file by a model's JSON, control characters escaped; raises `StorageError`."""
    replace_file(path, (visible(model.model_dump_json(indent=1)) + "\n").encode())


def read_json(path: Path, model: type[_Model], *, older: str = "") -> _Model:
    """The validated content of a file whose model has a `format` and a `version`, each of one literal value.

    Parameters
    ----------
    older : str
        Advice for a file of another version.

    Raises
    ------
    RecordingError
        Where the file cannot be read or has another content: file and field.
    """
    raw = _parsed(path)
    if not isinstance(raw, dict):
        raise RecordingError(str(path), "", f"expected a JSON object, got {type(raw).__name__}")
    name, version = (get_args(model.model_fields[field].annotation)[0] for field in ("format", "version"))
    if raw.get("format") != name:
        raise RecordingError(str(path), "format", f"expected {name!r}, got {raw.get('format')!r}"[:120])
    if raw.get("version") != version:
        expected = f"version {version} can be read, got {raw.get('version')!r}"[:120]
        raise RecordingError(str(path), "version", f"{expected}{older and '; '}{older}")
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        problem = first_problem(error, model, raw)
        raise RecordingError(str(path), problem.field, problem.text) from None


def _parsed(path: Path) -> Any:
    try:
        text = read_text(path, MAX_FILE_SIZES.generated_bytes)
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise RecordingError(str(path), "", f"not UTF-8 at byte {error.start}") from None
    try:
        return parse_json(text, parse_constant=_refuse, parse_float=_finite)
    except json.JSONDecodeError as error:
        raise RecordingError(f"{path}:{error.lineno}", "", f"broken JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(path), "", f"broken JSON: {error}") from None


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a number here")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large a number")
    return value
