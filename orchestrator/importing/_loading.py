"""From a YAML file to an `ImportMapping`, each complaint with file, line and key; no measurement is opened here."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from orchestrator._document import Document, parse_document
from orchestrator._validation import KeyPath, first_problem
from orchestrator.importing._mapping import ImportMapping
from protocols import InputError, ProcedureError


def read_mapping(path: Path) -> ImportMapping:
    """Read a mapping file; ``motor`` and ``drive`` may be paths, relative to it, of YAML files with these sections.

    Raises
    ------
    InputError
        One line: file and line, key path, what is wrong, the nearest valid name.
    """
    document = _parsed(path)
    for section in ("motor", "drive"):
        if isinstance(document.data.get(section), str):
            _lay_in(document, section, path.parent / document.data[section])
    return _validated(document)


def _parsed(path: Path) -> Document:
    try:
        return parse_document(path.read_text(encoding="utf-8"), str(path))
    except ProcedureError as error:
        raise InputError(error.where, error.field, error.problem) from None
    except OSError as error:
        raise InputError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise InputError(str(path), "", f"not UTF-8 at byte {error.start}") from None
    except ValueError as error:
        raise InputError(repr(str(path)), "", f"cannot be read: {error}") from None


def _lay_in(document: Document, section: str, path: Path) -> None:
    other = _parsed(path)
    if section not in other.data:
        raise InputError(other.name, section, "missing")
    places = {keys: place for keys, place in other.places.items() if keys[0] == section}
    document.replace((section,), other.data[section], places)


def _validated(document: Document) -> ImportMapping:
    try:
        # JSON mode is strict about types ("5" and true are no numbers) and still takes lists for tuples.
        return ImportMapping.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        problem = first_problem(error, ImportMapping, document.data)
    path, text = problem.path, problem.text
    if not path:
        # A check of the whole mapping starts its message with the place that it is about.
        named, colon, rest = text.partition(": ")
        keys: KeyPath = tuple(int(key) if key.isdecimal() else key for key in named.split("."))
        if colon and " " not in named:
            path, text = keys, rest
    raise InputError(document.place(path), ".".join(map(str, path)), text)
