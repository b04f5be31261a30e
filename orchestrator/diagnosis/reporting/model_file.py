"""`model.json`: the model as it stands, with its effects and its ladder; written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

from orchestrator._validation import first_problem
from orchestrator.diagnosis.fitting.model import Model
from orchestrator.recording import replace_file
from protocols import FoundEffect, RecordingError, Rung, StorageError, Strict

MODEL_NAME = "model.json"


class SavedMap(Strict):
    """Co-energy W(i): coefficients of a tensor of quintic B-splines, even in i_q."""

    d_low_a: float
    d_high_a: float
    q_high_a: float
    d_intervals: int
    q_intervals: int
    coefficients_j: tuple[float, ...]


class SavedModel(Strict):
    """The model of a recording."""

    format: Literal["fluxbench-model"] = "fluxbench-model"
    version: Literal[1] = 1
    recording: str
    baseline: str
    r_s_ohm: float
    pm_flux_wb: float
    magnetics: SavedMap
    effects: tuple[FoundEffect, ...]
    ladder: tuple[Rung, ...]


def saved_map(model: Model) -> SavedMap:
    """A model's magnetics as they are kept."""
    g = model.space.grid
    return SavedMap(
        d_low_a=g.low,
        d_high_a=g.high,
        q_high_a=g.reach,
        d_intervals=g.cells[0],
        q_intervals=g.cells[1],
        coefficients_j=tuple(float(c) for c in model.magnetics.coefficients),
    )


def write_model(directory: Path, model: SavedModel) -> str | None:
    """Replace `model.json` in a directory; what hindered it, where it could not be written."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        replace_file(directory / MODEL_NAME, (model.model_dump_json(indent=1) + "\n").encode())
    except (OSError, StorageError) as error:
        return f"{directory / MODEL_NAME} was not written: {error}"
    return None


def read_model(directory: Path) -> SavedModel | None:
    """The model kept in a directory; None where there is none.

    Raises
    ------
    RecordingError
        Where the file is not a model: which field is wrong.
    """
    path = directory / MODEL_NAME
    if not path.is_file():
        return None
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    except json.JSONDecodeError as error:
        raise RecordingError(f"{path}:{error.lineno}", "", f"broken JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(path), "", f"broken JSON: {error}") from None
    if not isinstance(raw, dict):
        raise RecordingError(str(path), "", f"expected a JSON object, got {type(raw).__name__}")
    try:
        return SavedModel.model_validate(raw)
    except ValidationError as error:
        problem = first_problem(error, SavedModel, raw)
        raise RecordingError(str(path), problem.field, problem.text) from None
