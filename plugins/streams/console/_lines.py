"""The run as JSON, one message a line, for programs that read along. For people there are other views."""

from __future__ import annotations

import json
from dataclasses import is_dataclass
from typing import Any, TextIO

import numpy as np
from pydantic import BaseModel

from plugins.streams.console._progress import Progress
from protocols import DiagnosisStep, FluxPoints, Message

A_ROW_EACH: dict[type[BaseModel], frozenset[str]] = {
    DiagnosisStep: frozenset({"stage"}),
    FluxPoints: frozenset({"segment"}),
}
"""Fields that are as long as the arrays beside them, though they are none."""


class JsonView:
    """Each message as one JSON object; arrays, and what names their rows, are left out."""

    def __init__(self, output: TextIO) -> None:
        self._output = output

    def show(self, message: Message, progress: Progress) -> None:
        self._output.write(json.dumps(without_arrays(message), ensure_ascii=True, allow_nan=False) + "\n")
        self._output.flush()

    def close(self) -> None:
        """There is nothing to put back."""


def without_arrays(model: BaseModel) -> dict[str, Any]:
    """The model as JSON takes it, without its arrays at any depth."""
    left_out = A_ROW_EACH.get(type(model), frozenset())
    whole: dict[str, Any] = model.model_dump(mode="json", exclude=_arrays(model) | left_out)
    for name in whole.keys() & type(model).model_fields.keys():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            whole[name] = without_arrays(value)
        elif isinstance(value, tuple) and any(isinstance(item, BaseModel) for item in value):
            whole[name] = [without_arrays(item) for item in value]
    return whole


def _arrays(model: BaseModel) -> set[str]:
    """Fields that are arrays, or that an estimate keeps for itself beside what its protocol says."""
    values = {name: getattr(model, name) for name in type(model).model_fields}
    return {name for name, value in values.items() if _is_left_out(value)}


def _is_left_out(value: object) -> bool:
    if isinstance(value, tuple):
        return any(map(_is_left_out, value))
    return isinstance(value, np.ndarray) or is_dataclass(value)
