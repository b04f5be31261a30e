"""`model.json` of a recording: read with errors of one line, written completely or not at all."""

from __future__ import annotations

from pathlib import Path

from orchestrator.formatting.sentences import visible
from orchestrator.recording._files import replace_file
from orchestrator.recording._json import read_json
from protocols import MotorModel, StorageError

MODEL_NAME = "model.json"
_OLDER = "`fluxbench diagnose` writes it again"


def read_model(path: Path) -> MotorModel:
    """The model in a file, or in the `model.json` of a directory.

    Raises
    ------
    RecordingError
        Where there is none, or a field is wrong.
    """
    return read_json(path / MODEL_NAME if path.is_dir() else path, MotorModel, older=_OLDER)


def has_model(directory: Path) -> bool:
    """Whether a recording or run has a `model.json`."""
    return (directory / MODEL_NAME).is_file()


def write_model(directory: Path, model: MotorModel) -> None:
    """Replace the `model.json` of a directory, which is created if missing; raises `StorageError`."""
    path = directory / MODEL_NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
        replace_file(path, (visible(model.model_dump_json(indent=1)) + "\n").encode())
    except (OSError, StorageError) as error:
        raise StorageError(f"{path} was not written: {error}") from None
