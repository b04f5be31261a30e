"""Pydantic's errors as one line: place, problem, and the nearest valid key."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

KeyPath = tuple[str | int, ...]

_UNITS = {
    "a": "A", "v": "V", "s": "s", "hz": "Hz", "rad": "rad", "wb": "Wb", "h": "H", "ohm": "ohm",
    "w": "W", "nm": "Nm", "rpm": "rpm", "j": "J", "c": "°C",
}  # fmt: skip
_EXPECTED = {
    "model_type": "keys and values",
    "model_attributes_type": "keys and values",
    "dict_type": "keys and values",
    "tuple_type": "a list",
    "list_type": "a list",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}
MAX_NAME_LENGTH = 200
"""Characters of an unknown name that are compared; the time grows with their square."""
MAX_DEPTH = 4
"""Sections within each other that are searched for the place of a misplaced key."""
_DECIMAL_COMMA = re.compile(r"\s*([-+]?\d+),(\d+\b.*)")
OTHER_MOTOR_KEYS = {
    "kv": "state pm_flux_wb, which is 5.513 / (pole_pairs x kv) for kv in rpm per volt (peak, line to line)",
    "ke": "state pm_flux_wb: peak phase voltage / (2 pi f electrical)",
    "kt": "state pm_flux_wb, which is kt / (1.5 x pole_pairs) for kt in Nm per ampere (peak)",
    "poles": "state pole_pairs, half the number of poles",
}
"""Quantities of data sheets that a motor's section has in another form, in lower case."""
_NUMBER_ERRORS = {"float_parsing", "float_type", "int_parsing", "int_type", "int_from_float"}


@dataclass(frozen=True)
class Problem:
    """The first error in a document."""

    path: KeyPath
    text: str
    is_missing: bool = False
    """Whether a required field is left out."""

    @property
    def field(self) -> str:
        """The key path, dotted."""
        return ".".join(map(str, self.path))


def first_problem(error: ValidationError, model: type[BaseModel] | None, raw: object) -> Problem:
    """The first error of a validation of `raw` against `model`.

    Parameters
    ----------
    model : type of BaseModel, optional
        The model of the validation; its fields are the candidates for the nearest valid key.
    raw : object
        The validated document of nested dicts and lists. It separates the keys in an error's
        location from the tags of unions.
    """
    errors = error.errors(include_url=False)
    # A misspelt key is unknown and missing at once: the first error is more helpful.
    found = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    path = _path_of(found, raw)
    if _is_list_for_number(found):
        # The field takes a number or a list, and a list was given: its items have the error.
        others = (e for e in errors if not _is_list_for_number(e) and _path_of(e, raw)[: len(path)] == path)
        found = next(others, found)
        path = _path_of(found, raw)
    if found["type"] == "union_tag_invalid":
        path = (*path, _discriminator(found))
    return Problem(path, _text(found, path, model), found["type"] == "missing")


def describe_problem(found: Any) -> str:
    """Text of one of pydantic's errors about a single value: what is expected, and what was given."""
    return _text(found, (), None)


def nearest(name: str, candidates: Iterable[str]) -> str | None:
    """The candidate most similar to `name`; None where none is similar."""
    close = difflib.get_close_matches(name[:MAX_NAME_LENGTH], list(candidates), n=1, cutoff=0.6)
    return close[0] if close else None


def suggestion(name: str, candidates: Iterable[str]) -> str:
    """A hint for an unknown `name`: the nearest candidate, or all of them where none is near."""
    names = sorted(candidates)
    near = nearest(name, names)
    if near is not None:
        return f"did you mean {near!r}?"
    return f"valid: {', '.join(names)}" if names else "none is valid here"


def missing_section(section: str, present: Iterable[str]) -> str:
    """That a section is missing, and the name among those present that is probably meant as it."""
    near = nearest(section, present)
    return "missing" if near is None else f"missing; the file has {near!r}: did you mean {section!r}?"


def _is_list_for_number(found: Any) -> bool:
    return found["type"] in _NUMBER_ERRORS and isinstance(found["input"], list | tuple)


def _path_of(found: Any, raw: Any) -> KeyPath:
    location = found["loc"]
    path: list[str | int] = []
    for place, key in enumerate(location):
        in_dict = isinstance(raw, dict) and key in raw
        in_list = isinstance(raw, list) and isinstance(key, int) and key < len(raw)
        if in_dict or in_list:
            raw = raw[key]
        elif not (found["type"] == "missing" and place == len(location) - 1):
            continue  # the tag of a union, not a key of the document
        path.append(key)
    return tuple(path)


def _text(found: Any, path: KeyPath, model: type[BaseModel] | None) -> str:
    kind, context = found["type"], found.get("ctx", {})
    key = str(path[-1]) if path else ""
    if kind == "extra_forbidden":
        valid = _valid_keys(model, found["loc"][:-1])
        other = OTHER_MOTOR_KEYS.get(key.lower().split("_")[0]) if "pm_flux_wb" in valid else None
        elsewhere = "" if nearest(key, valid) else _elsewhere(key, model, found["loc"][:-1])
        return f"unknown key; {other or _of_settings(key, valid) or elsewhere or suggestion(key, valid)}"
    if kind == "missing":
        return "missing"
    if kind == "union_tag_invalid":
        tags = [tag.strip().strip("'") for tag in context["expected_tags"].split(",")]
        return f"unknown {_discriminator(found)} {context['tag']!r}; {suggestion(context['tag'], tags)}"
    if kind == "union_tag_not_found":
        return f"{_discriminator(found)} is missing"
    if kind in _NUMBER_ERRORS:
        whole = "whole number" if kind.startswith("int") else "number"
        return f"expected a {whole}{_unit(path)}, got {_shown(found['input'])}{_comma_hint(found['input'])}"
    if kind == "literal_error":
        keys = found["input"] if isinstance(found["input"], dict) else ()
        hints = [hint for key in keys if (hint := _elsewhere(str(key), model, found["loc"][:-1]))]
        return "; ".join([f"expected {context['expected']}, got {_shown(found['input'])}", *hints])
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind]}, got {_shown(found['input'])}"
    message = str(found["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    message = message[:1].lower() + message[1:]
    return message if kind in ("value_error", "array") else f"{message}, got {_shown(found['input'])}"


def _of_settings(key: str, valid: Iterable[str]) -> str:
    """Where a set-point is written that is no key of its own; empty for another key."""
    names = set(valid)
    is_quantity = key.rsplit("_", 1)[-1] in _UNITS and "_" in key
    if "settings" not in names or not is_quantity or nearest(key, names) is not None:
        return ""
    return f"a set-point of the segment stands in settings: {{{key}: ...}}"


def _discriminator(found: Any) -> str:
    return str(found["ctx"]["discriminator"]).strip("'")


def _unit(path: KeyPath) -> str:
    name = next((key for key in reversed(path) if isinstance(key, str)), "")
    suffix = name.rsplit("_", 1)[-1] if "_" in name else ""
    return f" in {_UNITS[suffix]}" if suffix in _UNITS else ""


def _comma_hint(value: object) -> str:
    """How to write a number with a decimal comma; empty where there is none."""
    match = _DECIMAL_COMMA.match(value) if isinstance(value, str) else None
    return "" if match is None else f": write a decimal point, {match[1]}.{match[2]}"


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _valid_keys(model: type[BaseModel] | None, location: Sequence[str | int]) -> set[str]:
    return {name for m in _models_at(model, location) for name in m.model_fields}


def _models_at(model: type[BaseModel] | None, location: Sequence[str | int]) -> list[type[BaseModel]]:
    here, named_freely = [model] if model is not None else [], False
    for key in location:
        if isinstance(key, str) and not named_freely:
            fields = [outer.model_fields[key] for outer in here if key in outer.model_fields]
            here = [m for f in fields for m in _models_in(f)] or [m for m in here if _is_tagged(m, key)]
            named_freely = any(get_origin(f.annotation) is dict for f in fields)
        else:
            named_freely = False
    return here


def _elsewhere(key: str, model: type[BaseModel] | None, location: Sequence[str | int]) -> str:
    """Where below a place a key is written that does not belong there itself, by its name without a unit; or empty."""
    name, _, unit = key.rpartition("_")
    stem = name if name and unit in _UNITS else key
    places = [place for here in _models_at(model, location) for place in _places(here, stem)]
    return f"for {key} there is {' or '.join(dict.fromkeys(places))}" if places else ""


def _places(model: type[BaseModel], stem: str, within: tuple[str, ...] = ()) -> Iterator[str]:
    """Dotted paths of values named so, apart from their unit, and of those that a section of this name requires."""
    for name, field in model.model_fields.items():
        path = (*within, name)
        models = _models_in(field.annotation) if len(path) < MAX_DEPTH else []
        own_stem, _, unit = name.rpartition("_")
        if not models and (name == stem or (own_stem == stem and unit in _UNITS)):
            yield ".".join(path)
        for inner in models:
            if name == stem:
                yield from (".".join((*path, n)) for n, f in inner.model_fields.items() if f.is_required())
            else:
                yield from _places(inner, stem, path)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    annotation = getattr(annotation, "annotation", annotation)
    if isinstance(annotation, type) and get_origin(annotation) is None:
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _is_tagged(model: type[BaseModel], tag: str) -> bool:
    fields = model.model_fields.values()
    return any(get_origin(f.annotation) is Literal and tag in get_args(f.annotation) for f in fields)
