"""Read mapping files from YAML; errors name file, line and key. Opens no measurement."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from orchestrator.importing._mapping import OVERRIDING, FileRule, ImportedDrive, ImportMapping
from orchestrator.validation.messages import KeyPath, first_problem, missing_section
from orchestrator.validation.quantities import read_quantities
from orchestrator.validation.strict_yaml import Document, read_document
from protocols import InputError, ProcedureError

SIMULATED = "simulated"
"""Drive of a motor file that no log is of: such a file names there what `run` drives."""
UNKNOWN = "unknown"

_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True)
class MappingFile:
    """The content of a mapping file: one mapping for all files, or several by file name."""

    common: ImportMapping
    """The mapping of the whole recording; it describes columns only where `complete`."""
    complete: InputError | None
    """Reason why files that match no rule cannot be read; None where they can."""
    rules: tuple[tuple[FileRule, ImportMapping], ...]
    readings: tuple[str, ...] = ()
    """Conversions of quantities with a unit, one sentence each."""

    def of(self, path: Path) -> tuple[FileRule | None, ImportMapping]:
        """The first rule that a file matches, and its mapping; raises `InputError` where there is none."""
        index = self.first_rule(path)
        if index is not None:
            return self.rules[index]
        if self.complete is not None:
            raise InputError(str(path), "", f"fits no entry of files, and without one: {self.complete}")
        return None, self.common

    def check_all_used(self, mapping: Path, files: Sequence[Path]) -> None:
        """Raise `InputError` where a rule matches none of the files."""
        for index, (rule, _) in enumerate(self.rules):
            if all(self.first_rule(path) != index for path in files):
                raise InputError(str(mapping), f"files.{index}", f"no file fits it ({rule.file!r})")

    def first_rule(self, path: Path) -> int | None:
        """Index of the first rule that a file matches."""
        return next((k for k, (rule, _) in enumerate(self.rules) if fnmatchcase(path.name, rule.file)), None)


def read_mapping(path: Path) -> MappingFile:
    """Read a mapping file; ``motor`` and ``drive`` may be paths, relative to it, of YAML files with these sections.

    Values of both may have units, as in a procedure.

    Raises
    ------
    InputError
        One line: file and line, key path, what is wrong, the nearest valid name.
    """
    document = read_document(path)
    if document.data.get("format") == "fluxbench-map":
        raise InputError(str(path), "format", "the mapping of a flux map, not of waveforms: `fluxbench audit` reads it")
    for section in ("motor", "drive"):
        if isinstance(document.data.get(section), str):
            _lay_in(document, section, path.parent / document.data[section])
    try:
        # Columns state their units in their own sections.
        readings = read_quantities(document, ("motor", "drive"))
    except ProcedureError as error:
        raise InputError(error.where, error.field, error.problem) from None
    entries = document.data.pop("files", None)
    if entries is None:
        return MappingFile(_validated(document, ImportMapping, document.data), None, (), tuple(readings))
    if not isinstance(entries, list) or not entries:
        raise InputError(document.place(("files",)), "files", "expected a list of entries with file")
    rules = tuple(_rule(document, index, entry) for index, entry in enumerate(entries))
    try:
        return MappingFile(_validated(document, ImportMapping, document.data), None, rules, tuple(readings))
    except InputError as error:
        return MappingFile(rules[0][1], error, rules, tuple(readings))


def read_drive(path: Path) -> ImportedDrive | None:
    """The drive of a motor file, without the options of its plugin; None where no bus voltage is stated.

    Raises
    ------
    InputError
        As `read_mapping`.
    """
    document = read_document(path)
    try:
        read_quantities(document, ("drive",))
    except ProcedureError as error:
        raise InputError(error.where, error.field, error.problem) from None
    section = document.data.get("drive")
    if not isinstance(section, dict) or "dc_bus_voltage_v" not in section:
        return None
    known = {key: value for key, value in section.items() if key in ImportedDrive.model_fields}
    return _validated(document, ImportedDrive, {"name": UNKNOWN, **_logged(known)}, ("drive",))


def _rule(document: Document, index: int, entry: Any) -> tuple[FileRule, ImportMapping]:
    rule = _validated(document, FileRule, entry, ("files", index))
    given = {key: value for key, value in entry.items() if key in OVERRIDING}
    return rule, _validated(document, ImportMapping, _laid_over(document.data, given), ("files", index), given)


def _laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Two merged sections; the upper one overrides key by key, except that a signal's columns are replaced."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(below.get(key), dict) and key != "columns"
        merged[key] = _laid_over(below[key], value) if both else value
    return merged


def _lay_in(document: Document, section: str, path: Path) -> None:
    other = read_document(path)
    if section not in other.data:
        raise InputError(other.name, section, missing_section(section, other.data))
    places = {keys: place for keys, place in other.places.items() if keys[0] == section}
    document.replace((section,), _logged(other.data[section]), places)


def _logged(section: Any) -> Any:
    """A section of a motor file for a log, which is not of the simulated drive."""
    is_simulated = isinstance(section, dict) and section.get("name") == SIMULATED
    return {**section, "name": UNKNOWN} if is_simulated else section


def _validated(
    document: Document, model: type[_Model], data: Any, under: KeyPath = (), given: Mapping[str, Any] | None = None
) -> _Model:
    """`data` as a validated model; raises `InputError` with the key's place below `under`, or in `given`."""
    try:
        # JSON mode is strict about types ("5" and true are no numbers) and still takes lists for tuples.
        return model.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        problem = first_problem(error, model, data)
    path, text = problem.path, problem.text
    if not path:
        # A check of the whole mapping starts its message with the place that it is about.
        named, colon, rest = text.partition(": ")
        keys: KeyPath = tuple(int(key) if key.isdecimal() else key for key in named.split("."))
        if colon and " " not in named:
            path, text = keys, rest
    if given is None or (path[:1] and path[0] in given):
        path = (*under, *path)
    raise InputError(document.place(path), ".".join(map(str, path)), text)
