"""Join columns of several files by time: a scope's channels, or a second logger with its own clock.

Voltages are held between samples and are resampled by volt-seconds; other signals are interpolated linearly. Files with
equal time stamps are joined without resampling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from orchestrator.importing._aligning import fitted_clock
from orchestrator.importing._findings import Findings
from orchestrator.importing._loading import MappingFile
from orchestrator.importing._mapping import FileRule, ImportMapping
from orchestrator.importing._opening import open_source
from orchestrator.importing._source import Block, Labels, Numbers, Source, whole
from orchestrator.importing._stamps import Stamps
from orchestrator.importing._timing import held_means
from protocols import InputError


@dataclass(frozen=True)
class Beside:
    """A file whose columns join another file's rows."""

    path: Path
    rule: FileRule
    mapping: ImportMapping


def paired(mappings: MappingFile, files: Sequence[Path]) -> dict[Path, list[Beside]]:
    """The primary files, each with the files to join to it; raises `InputError` where they do not pair."""
    which = {path: mappings.first_rule(path) for path in files}
    aside = [path for path, k in which.items() if k is not None and mappings.rules[k][0].beside is not None]
    pairs: dict[Path, list[Beside]] = {path: [] for path in files if path not in aside}
    for rule, mapping in mappings.rules:
        if rule.beside is None:
            continue
        these = [path for path in aside if mappings.of(path)[0] is rule]
        those = [path for path in pairs if fnmatchcase(path.name, rule.beside)]
        if len(these) != len(those):
            named = str(these[0]) if these else rule.file
            raise InputError(
                named,
                "beside",
                f"{len(these)} files fit {rule.file!r}, {len(those)} fit {rule.beside!r}: one each is needed",
            )
        for path, main in zip(these, those, strict=True):
            pairs[main].append(Beside(path, rule, mapping))
    return pairs


def open_joined(
    path: Path, rule: FileRule | None, mapping: ImportMapping, others: Sequence[Beside], findings: Findings
) -> Source:
    """A file with the columns of the files joined to it; joined files are held in memory as a whole.

    Raises
    ------
    InputError
        Where a file cannot be read, has no rows in common, or the edges do not determine the clocks' offset.
    """
    elsewhere = {name for other in others for name in other.rule.names}
    main = open_source(path, mapping, {} if rule is None else rule.names, without=elsewhere)
    if not others:
        return main
    stamps, rows = Stamps(), whole(path, main)
    time_s = stamps.seconds(mapping, rows, 0)
    numbers, units = dict(rows.numbers), dict(main.units)
    for other in others:
        _lay_beside(path, other, mapping, (time_s, stamps), numbers, units, findings)
    there = np.all([np.isfinite(numbers[name]) for name in elsewhere], axis=0)
    if not there.any():
        raise InputError(str(others[0].path), "", f"has no row at the time of one in {path.name}")
    first, end = int(np.argmax(there)), there.size - int(np.argmax(there[::-1]))
    if end - first < there.size:
        findings.dropped_rows["nothing beside"] += there.size - (end - first)
    labels = None if rows.labels is None else Labels(rows.labels.codes[first:end], rows.labels.names)
    return Source([Block({name: values[first:end] for name, values in numbers.items()}, labels)], units)


def _lay_beside(
    path: Path,
    other: Beside,
    mapping: ImportMapping,
    clock: tuple[Numbers, Stamps],
    numbers: dict[str, Numbers],
    units: dict[str, str],
    findings: Findings,
) -> None:
    time_s, stamps = clock
    source = open_source(other.path, other.mapping, other.rule.names, only=set(other.rule.names))
    units |= source.units
    rows = whole(other.path, source)
    stamps.next_file()
    other_s = stamps.seconds(other.mapping, rows, 0)
    for name in other.rule.names:
        if name not in rows.numbers:
            raise InputError(str(other.path), name, "is to be laid beside, but nothing in the mapping uses it")
    known = np.isfinite(other_s)
    other_s, columns = other_s[known], {name: rows.numbers[name][known] for name in other.rule.names}
    if other_s.size < 2 or np.any(np.diff(other_s) <= 0):
        raise InputError(str(other.path), "time", "does not increase")
    if other.rule.align == "edges":
        other_s, remark = fitted_clock(path, other.path, mapping, (numbers, columns), (time_s, other_s))
        findings.note("aligned", remark)
    held = set(mapping.voltage.columns.values())
    for name, values in columns.items():
        numbers[name] = _laid(time_s, other_s, values, name in held)


def _laid(time_s: Numbers, other_s: Numbers, values: Numbers, is_held: bool) -> Numbers:
    """Values with time stamps `other_s`, resampled to `time_s`; NaN where no sample is near."""
    step_s = float(np.median(np.diff(other_s)))
    if time_s.size == other_s.size and np.max(np.abs(time_s - other_s), initial=0.0) < 0.01 * step_s:
        return values
    if is_held:
        next_s = np.append(time_s[1:], 2.0 * time_s[-1] - time_s[-2])
        # A later check reports missing stamps and values with their rows.
        limits_s = np.maximum.accumulate(np.nan_to_num(np.append(time_s, next_s[-1]), nan=-np.inf))
        out = held_means(other_s, values[:, None], limits_s)[:, 0]
        inside = (time_s >= other_s[0]) & (next_s <= other_s[-1] + 1.01 * step_s)
    else:
        out = np.interp(time_s, other_s, values)
        inside = (time_s >= other_s[0]) & (time_s <= other_s[-1])
    index = np.clip(np.searchsorted(other_s, time_s, side="right"), 1, other_s.size - 1)
    inside &= (other_s[index] - other_s[index - 1] < 1.5 * step_s) | (np.abs(other_s[index] - time_s) < 0.01 * step_s)
    return np.where(inside, out, np.nan)
