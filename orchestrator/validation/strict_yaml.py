"""Strict YAML for procedures: plain values only, with the file and line of every key.

Numbers and booleans are YAML 1.2's (``1e3`` is a number, ``yes`` is a word), a key may be written
once, NaN and infinity are refused, and there are no tags, anchors or aliases. The keys are not
interpreted here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.validation.json_text import refuse_half_characters
from orchestrator.validation.messages import KeyPath, nearest
from orchestrator.validation.plain_files import read_text
from protocols import InputError, ProcedureError

_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|infinity|nan)", re.IGNORECASE)
_WORDS: dict[str, bool | None] = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys(("null", "Null", "NULL", "~", ""), None),
}


@dataclass(frozen=True)
class Document:
    """A tree of plain values, with the file and line of each."""

    name: str
    data: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place(self, path: KeyPath) -> str:
        """File and line of the value at `path`, or of the nearest one around it."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return self.name

    def place_of(self, field: str) -> str:
        """`place` of a dotted key path."""
        path: KeyPath = ()
        for key in field.split("."):
            # A number may be an index of a list, or a key.
            path = (*path, int(key) if key.isdecimal() and (*path, key) not in self.places else key)
        return self.place(path)

    def replace(self, path: KeyPath, value: object, places: dict[KeyPath, str]) -> None:
        """Replace the value at `path`, whose parents exist."""
        parent: Any = self.data
        for key in path[:-1]:
            parent = parent[key]
        parent[path[-1]] = value
        for old in [known for known in self.places if known[: len(path)] == path]:
            del self.places[old]
        self.places.update(places)


def parse_document(text: str, name: str) -> Document:
    """Parse a YAML file whose outermost value is a mapping; raises `ProcedureError` naming the line."""
    reading = _Reading(name)
    data = reading.parse(text)
    if not isinstance(data, dict):
        raise ProcedureError(
            name, "", f"expected keys and values, got {'nothing' if data is None else repr(data)[:60]}"
        )
    return Document(name, data, reading.places)


def read_document(path: Path, error: type[InputError] = InputError) -> Document:
    """Read and parse a YAML file; where it cannot be read, or is no mapping, `error` names file and line."""
    if path.is_dir():
        raise error(str(path), "", "is a directory; expected a YAML file")
    try:
        return parse_document(read_text(path), str(path))
    except ProcedureError as problem:
        raise error(problem.where, problem.field, problem.problem) from None
    except OSError as problem:
        raise error(str(path), "", f"cannot be read: {problem.strerror or problem}{_nearest_file(path)}") from None
    except UnicodeDecodeError as problem:
        raise error(str(path), "", f"not UTF-8 at byte {problem.start}") from None
    except ValueError as problem:
        raise error(repr(str(path)), "", f"cannot be read: {problem}") from None


def _nearest_file(path: Path) -> str:
    """A hint at the YAML file of that folder with the most similar name; empty where the file is there, or none is."""
    if path.exists() or not path.parent.is_dir():
        return ""
    near = nearest(path.name, [file.name for ending in ("yaml", "yml") for file in path.parent.glob(f"*.{ending}")])
    return "" if near is None else f"; did you mean {str(path.with_name(near))!r}?"


def apply_override(document: Document, override: str) -> None:
    """Apply an override ``a.b.2.c=value`` with a YAML value to a document; raises `ProcedureError` naming it."""
    where = f"--set {override}"
    dotted, equals, text = override.partition("=")
    if not equals or not all(part.strip() for part in dotted.split(".")):
        raise ProcedureError(where, "", "expected key.path=value")
    path = _resolve(document, [part.strip() for part in dotted.split(".")], where)
    value = _Reading(where, with_lines=False).parse(text)
    document.replace(path, value, {path: where})


def _resolve(document: Document, parts: Sequence[str], where: str) -> KeyPath:
    here: Any = document.data
    path: list[str | int] = []
    for place, part in enumerate(parts):
        key: str | int = part
        if isinstance(here, list):
            if not part.isdecimal() or int(part) >= len(here):
                raise ProcedureError(
                    where, ".".join(map(str, path)), f"expected an index from 0 to {len(here) - 1}, got {part!r}"
                )
            key = int(part)
        elif not isinstance(here, dict):
            raise ProcedureError(where, ".".join(map(str, path)), f"is {here!r}, nothing is below it")
        path.append(key)
        if place == len(parts) - 1:
            break
        if isinstance(here, dict) and here.get(part) is None:
            here[part] = {}
            document.places[tuple(path)] = where
        here = here[key]
    return tuple(path)


class _Reading:
    """One pass over one text: PyYAML parses, and this class converts values and notes their places."""

    def __init__(self, name: str, *, with_lines: bool = True) -> None:
        self._name, self._with_lines = name, with_lines
        self.places: dict[KeyPath, str] = {}

    def parse(self, text: str) -> Any:
        import yaml

        try:
            events = yaml.parse(text, Loader=yaml.SafeLoader)
            return self._document(event for event in events if not isinstance(event, yaml.StreamStartEvent))
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            problem = error.problem or error.context or ""
            advice = "; a tab stands here: indent with spaces" if "'\\t'" in problem else ""
            raise ProcedureError(self._at(mark), "", f"not YAML: {problem}{advice}") from None
        except yaml.YAMLError as error:
            raise ProcedureError(self._name, "", f"not YAML: {str(error).splitlines()[0]}") from None

    def _document(self, events: Iterator[Any]) -> Any:
        if _kind(next(events)) == "StreamEnd":
            return None
        value = self._value(next(events), events, ())
        next(events)
        after = next(events)
        if _kind(after) != "StreamEnd":
            raise self._wrong(after, (), "a second document starts here")
        return value

    def _value(self, event: Any, events: Iterator[Any], path: KeyPath) -> Any:
        if event.anchor is not None:
            raise self._wrong(event, path, "anchors and aliases are not used here")
        if event.tag is not None:
            raise self._wrong(event, path, f"the tag {event.tag} is not used here")
        if len(path) > 30:  # before Python itself gives up
            raise self._wrong(event, path[:3], "nested too deeply")
        if _kind(event) == "MappingStart":
            return self._mapping(events, path)
        if _kind(event) == "SequenceStart":
            return self._sequence(events, path)
        try:
            refuse_half_characters(event.value)
        except ValueError as error:
            raise self._wrong(event, path, str(error)) from None
        return event.value if event.style is not None else self._plain(event, path)

    def _mapping(self, events: Iterator[Any], path: KeyPath) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for key_event in _until(events, "MappingEnd"):
            if _kind(key_event) != "Scalar":
                raise self._wrong(key_event, path, "a key has to be a word")
            key = key_event.value
            below = (*path, key)
            if key in mapping:
                raise self._wrong(key_event, below, f"written twice (first in {self.places[below]})")
            self.places[below] = self._at(key_event.start_mark)
            mapping[key] = self._value(next(events), events, below)
        return mapping

    def _sequence(self, events: Iterator[Any], path: KeyPath) -> list[Any]:
        sequence: list[Any] = []
        for event in _until(events, "SequenceEnd"):
            below = (*path, len(sequence))
            self.places[below] = self._at(event.start_mark)
            sequence.append(self._value(event, events, below))
        return sequence

    def _plain(self, event: Any, path: KeyPath) -> Any:
        text: str = event.value
        if text in _WORDS:
            return _WORDS[text]
        if _INT.fullmatch(text) and len(text) <= 100:
            return int(text)
        if _NOT_FINITE.fullmatch(text):
            raise self._wrong(event, path, f"expected a finite number, got {text}")
        if _FLOAT.fullmatch(text):
            number = float(text)
            if not math.isfinite(number):
                raise self._wrong(event, path, f"{text[:40]} is too large a number")
            return number
        return text

    def _wrong(self, event: Any, path: KeyPath, problem: str) -> ProcedureError:
        return ProcedureError(self._at(event.start_mark), ".".join(map(str, path)), problem)

    def _at(self, mark: Any) -> str:
        return f"{self._name}:{mark.line + 1}" if self._with_lines and mark is not None else self._name


def _until(events: Iterator[Any], end: str) -> Iterator[Any]:
    for event in events:
        if _kind(event) == end:
            return
        yield event


def _kind(event: Any) -> str:
    return type(event).__name__.removesuffix("Event")
