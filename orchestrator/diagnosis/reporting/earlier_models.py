"""The models that `add` changed, by the effect that it added, so that `remove` can return to them."""

from __future__ import annotations

from pathlib import Path

from orchestrator.diagnosis.reporting.motor_model import reduced
from orchestrator.recording import read_model, write_json
from protocols import MotorModel, StorageError

FOLDER = "earlier"
"""Folder of the earlier models, beside `model.json`."""


def keep_earlier(directory: Path, name: str, model: MotorModel) -> None:
    """Store the model that an effect was added to; raises `StorageError`."""
    if not name.isidentifier():  # a name of one's own may be no file's
        return
    path = _path(directory, name)
    try:
        path.parent.mkdir(exist_ok=True)
        write_json(path, model)
    except (OSError, StorageError) as error:
        raise StorageError(f"{path} was not written: {error}") from None


def earlier_model(directory: Path, name: str, saved: MotorModel) -> MotorModel | None:
    """The model that an effect was added to; None where the saved one is not just that and the effect.

    Raises
    ------
    RecordingError
        If its file is damaged.
    """
    path = _path(directory, name)
    if not name.isidentifier() or saved.ladder[-1].added != name or not path.is_file():
        return None
    earlier = read_model(path)
    is_its = (
        (earlier.recording, earlier.motor, earlier.noise) == (saved.recording, saved.motor, saved.noise)
        and [e.name for e in earlier.effects] == [e.name for e in reduced(saved, [name]).effects]
        # A refit restates the last rung.
        and earlier.ladder[:-1] == saved.ladder[:-2]
    )
    return earlier if is_its else None


def _path(directory: Path, name: str) -> Path:
    return directory / FOLDER / f"without-{name}.json"
