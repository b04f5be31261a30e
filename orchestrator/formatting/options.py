"""All options of a plugin as a table in Markdown: one row each, with the text of its docstring."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined


def options_table(model: type[BaseModel]) -> str:
    """Option, default and meaning of each; nested options by their dotted path."""
    rows = [f"| `{path}` | {_default(field)} | {_meaning(field)} |" for path, field in _options(model, "", ())]
    return "\n".join(["| option | default | |", "| --- | --- | --- |", *rows])


def _options(
    model: type[BaseModel], prefix: str, above: tuple[type[BaseModel], ...]
) -> Iterator[tuple[str, FieldInfo]]:
    seen: set[str] = set()
    for name, field in model.model_fields.items():
        below = [inner for inner in _models(field.annotation) if inner not in above]
        if not below:
            yield f"{prefix}{name}", field
        for inner in below:
            for path, one in _options(inner, f"{prefix}{name}.", (*above, model)):
                if path not in seen:  # alternatives share some options
                    seen.add(path)
                    yield path, one


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for inner in get_args(annotation) for model in _models(inner)]


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "required" if field.default_factory is None else "none"
    if field.default in (None, ()):
        return "none"
    return f"`{json.dumps(field.default, default=str)}`".replace('"', "")


def _meaning(field: FieldInfo) -> str:
    words = " ".join((field.description or "").split()).replace("|", "\\|").replace("``", "`")
    choices = [str(choice) for inner in _flat(field.annotation) for choice in get_args(inner)]
    return " ".join(part for part in (f"One of {', '.join(choices)}." if len(choices) > 1 else "", words) if part)


def _flat(annotation: Any) -> list[Any]:
    """The `Literal`s in an annotation."""
    if get_origin(annotation) is Literal:
        return [annotation]
    return [one for inner in get_args(annotation) for one in _flat(inner)]
