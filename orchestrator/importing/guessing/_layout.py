"""Detect a text file's layout from its first lines: preamble, names, units, delimiter, decimal mark."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from orchestrator.importing._mapping import CsvLayout
from orchestrator.importing.guessing._units import unit_of
from protocols import InputError

_LINES = 400
_BYTES = 1 << 18
_METADATA = re.compile(r"(unit|type|interp|block ?path|port ?index|enum): *(.*)", re.IGNORECASE)
"""Rows below the names in files of Simulink's Data Inspector."""

_NO_UNIT = ("sequence", "-", "none", "string", "text")


@dataclass(frozen=True)
class TextLayout:
    """The section `csv` of a mapping with its reason, and the file's column names and units."""

    csv: CsvLayout
    why: str
    names: tuple[str, ...]
    units: dict[str, str]
    increment_s: float | None = None
    """The sampling period from the preamble (Rigol), or None."""


@dataclass(frozen=True)
class _Try:
    delimiter: str
    decimal: Literal[".", ","]
    rows: list[list[str]]
    first: int
    """Index of the first line of numbers."""
    score: int


def text_layout(path: Path) -> TextLayout:
    """The layout of a text file; raises `InputError` where there is no table of numbers in it."""
    text, encoding = _decoded(path)
    lines = text.splitlines()[:_LINES]
    if len(text) >= _BYTES:
        lines = lines[:-1]
    ways: list[tuple[str, Literal[".", ","]]] = [(";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", ".")]
    tries = [_tried(lines, delimiter, decimal) for delimiter, decimal in ways]
    best = max(tries, key=lambda one: one.score)
    if best.score == 0:
        raise InputError(str(path), "", "no table of numbers, separated by comma, semicolon or tab, in its first lines")
    rows, first = best.rows, best.first
    width = len(rows[first])
    above = first - 1
    units: list[str] = []
    metadata = False
    while above > 0 and _is_described(rows[above]) and (found := _units_in(rows[above])) is not None:
        units = found if any(found) else units
        metadata = True
        above -= 1
    named = above >= 0 and _is_header(rows[above], width)
    header = [name.strip() for name in rows[above]] if named else []
    names = [header[k] if k < len(header) and header[k] else f"column_{k + 1}" for k in range(width)]
    as_read = named and header == names and len(set(names)) == width
    names = [name if names.index(name) == k else f"{name}_{k + 1}" for k, name in enumerate(names)]
    layout = CsvLayout(
        delimiter=best.delimiter,
        decimal=best.decimal,
        skip_rows=above if as_read else first,
        skip_rows_after_names=first - above - 1 if as_read else 0,
        names=None if as_read else tuple(names),
        encoding=encoding,
    )
    why = f"numbers begin in line {first + 1}, " + (f"names are in line {above + 1}" if named else "nothing names them")
    if metadata and units:
        why += ", units below them"
    given = dict(zip(names, units, strict=False)) if units else {}
    return TextLayout(layout, why, tuple(names), given, _increment(rows, above, named))


def _decoded(path: Path) -> tuple[str, Literal["utf-8", "latin-1", "utf-16"]]:
    with path.open("rb") as file:
        head = file.read(_BYTES)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return head.decode("utf-16", errors="ignore"), "utf-16"
    try:
        return head.decode("utf-8-sig"), "utf-8"
    except UnicodeDecodeError as error:
        if error.start > len(head) - 4:
            return head[: error.start].decode("utf-8-sig"), "utf-8"
        return head.decode("latin-1"), "latin-1"


def _tried(lines: Sequence[str], delimiter: str, decimal: Literal[".", ","]) -> _Try:
    """The longest run of rows of numbers with this delimiter and decimal mark."""
    rows = list(csv.reader(lines, delimiter=delimiter))
    counts = [_numbers(row, decimal) for row in rows]
    best = (0, 0)
    start = 0
    for k in range(len(rows) + 1):
        if k < len(rows) and counts[k] >= 2 and len(rows[k]) == len(rows[start]):
            continue
        best = max(best, (sum(counts[start:k]), -start))
        start = k if k < len(rows) and counts[k] >= 2 else k + 1
        start = min(start, len(rows) - 1)
    score, first = best[0], -best[1]
    return _Try(delimiter, decimal, rows, first, score)


def _numbers(row: Sequence[str], decimal: str) -> int:
    """Number of numeric fields; zero where all other fields of a row are texts."""
    other = "," if decimal == "." else "."
    found = 0
    for field in row:
        if other in field:
            continue
        try:
            float(field.replace(decimal, "."))
        except ValueError:
            continue
        found += 1
    return found if found >= 2 else 0


def _is_header(row: Sequence[str], width: int) -> bool:
    fields = _stripped(row)
    return width - 2 <= len(fields) <= width + 2 and len(fields) > 1 and _numbers(fields, ".") < 0.5 * len(fields)


def _is_described(row: Sequence[str]) -> bool:
    fields = _stripped(row)
    return len(fields) > 1 or bool(fields and _METADATA.fullmatch(fields[0]))


def _stripped(row: Sequence[str]) -> list[str]:
    """The fields without the empty one after a trailing delimiter."""
    fields = [field.strip() for field in row]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _units_in(row: Sequence[str]) -> list[str] | None:
    """The units in a row of units (with numbers, for Rigol); None for any other row."""
    units: list[str] = []
    for field in (field.strip() for field in row):
        described = _METADATA.fullmatch(field)
        if described is not None:
            units.append(unit_of(described[2]) or "" if described[1].lower() == "unit" else "")
        elif not field or field.strip("[]()").lower() in _NO_UNIT or _is_number(field):
            units.append("")
        else:
            unit = unit_of(field)
            if unit is None:
                return None
            units.append(unit)
    return units


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _increment(rows: Sequence[Sequence[str]], above: int, named: bool) -> float | None:
    if not named:
        return None
    for name, value in zip(rows[above], rows[above + 1], strict=False):
        if name.strip().lower() == "increment" and _is_number(value):
            return float(value)
    return None
