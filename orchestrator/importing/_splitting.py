"""Split rows into segments by the mapping's rules, without regard to the values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._mapping import ImportMapping, SegmentRule
from orchestrator.importing._source import Block, Labels, Numbers
from orchestrator.importing._stamps import Stamps
from orchestrator.validation.memory import require_memory
from protocols import InputError

_NO_RULE = -1


@dataclass(frozen=True)
class RawSegment:
    """Consecutive rows of one file that make a segment."""

    path: Path
    mapping: ImportMapping
    """Mapping of the file."""
    rule: int
    """Index of the rule among the mapping's segments."""
    first_row: int
    """Counted from 0."""
    columns: Mapping[str, Numbers]
    """Columns of the signals in the file's numbers; NaN where a sample is missing."""
    time_s: Numbers
    """Time stamps [s]; without a time column, the time since the file's first row."""


@dataclass
class Leftover:
    """Rows that match no rule."""

    rows: int = 0
    first: str = ""


class _Growing:
    """A column that grows in parts, so that growth never copies the whole column."""

    LEAST, MOST = 1 << 14, 1 << 22
    """Rows of a part: each as large as all before, up to a size that the system reclaims when it is freed."""

    def __init__(self) -> None:
        self._parts: list[Numbers] = []
        self._filled = self._rows = 0

    def add(self, values: Numbers) -> None:
        # A view would keep its whole block in memory.
        while values.size:
            if not self._parts or self._filled == self._parts[-1].size:
                self._parts.append(np.empty(min(max(self.LEAST, self._rows), self.MOST)))
                self._filled = 0
            now = min(self._parts[-1].size - self._filled, values.size)
            self._parts[-1][self._filled : self._filled + now] = values[:now]
            values, self._filled, self._rows = values[now:], self._filled + now, self._rows + now

    def whole(self) -> Numbers:
        """All rows; frees the parts."""
        out, start = np.empty(self._rows), 0
        while self._parts:
            part = self._parts.pop(0)[: self._rows - start]
            out[start : start + part.size] = part
            start += part.size
        return out


@dataclass
class _Open:
    """A segment that may continue in the next block."""

    key: tuple[int, str, float]
    """Rule, label, and number in the column of the PWM frequency."""
    first_row: int
    rows: int = 0
    columns: dict[str, _Growing] = field(default_factory=dict)
    time: _Growing = field(default_factory=_Growing)

    def add(self, path: Path, columns: Mapping[str, Numbers], time_s: Numbers, rows: slice) -> None:
        self.rows += rows.stop - rows.start
        size = self.rows * (len(columns) + 1) * time_s.itemsize
        require_memory(path, size, f"{self.rows} rows in one segment", held=size)
        for name, values in columns.items():
            self.columns.setdefault(name, _Growing()).add(values[rows])
        self.time.add(time_s[rows])

    def close(self, path: Path, mapping: ImportMapping) -> RawSegment:
        columns = {name: column.whole() for name, column in self.columns.items()}
        return RawSegment(path, mapping, self.key[0], self.first_row, columns, self.time.whole())


class Splitter:
    """Cuts files into segments, in the order of their rows; holds one segment at a time.

    Attributes
    ----------
    leftover : Leftover
        Rows that matched no rule so far.
    rows : int
        Number of rows in all blocks so far.
    """

    def __init__(self, mapping: ImportMapping) -> None:
        self._mapping = mapping
        self._used: set[int] = set()
        self._stamps = Stamps()
        self.leftover = Leftover()
        self.rows = 0

    def raw_segments(self, path: Path, mapping: ImportMapping, blocks: Iterator[Block]) -> Iterator[RawSegment]:
        """The segments of one file, by its mapping."""
        rules = [
            (index, rule)
            for index, rule in enumerate(self._mapping.segments)
            if rule.file is None or fnmatchcase(path.name, rule.file)
        ]
        signals = mapping.signal_columns()
        self._stamps.next_file()
        opened: _Open | None = None
        row = 0
        for block in blocks:
            time_s = self._stamps.seconds(mapping, block, row)
            labels = block.labels or Labels(np.zeros(len(block), dtype=np.intp), ("",))
            which = _matching_rule(rules, labels, time_s)
            pwm = self._pwm_numbers(mapping, block, opened)
            for start, end in _runs(which, labels.codes, pwm):
                key = (int(which[start]), labels.names[labels.codes[start]], float(pwm[start]))
                if opened is not None and opened.key != key:
                    yield opened.close(path, mapping)
                    opened = None
                if key[0] == _NO_RULE:
                    self._leave_out(path, row + start, end - start, key[1])
                    continue
                self._used.add(key[0])
                opened = opened or _Open(key, row + start)
                opened.add(path, {name: block.numbers[name] for name in signals}, time_s, slice(start, end))
            row += len(block)
            self.rows += len(block)
        if opened is not None:
            yield opened.close(path, mapping)

    @property
    def since_epoch(self) -> bool:
        """Whether the time stamps are dates."""
        return self._stamps.since_epoch

    def check_all_used(self, where: str) -> None:
        """Raise `InputError` where a rule matched no row of any file."""
        for index, rule in enumerate(self._mapping.segments):
            if index not in self._used:
                conditions = {name: getattr(rule, name) for name in ("file", "label", "from_s", "to_s")}
                words = ", ".join(f"{name} {value!r}" for name, value in conditions.items() if value is not None)
                raise InputError(where, f"segments.{index}", f"no row fits it ({words or 'an earlier one takes all'})")

    @staticmethod
    def _pwm_numbers(mapping: ImportMapping, block: Block, opened: _Open | None) -> Numbers:
        """The column of the PWM frequency, a missing number replaced by the one before it; zeros without a column."""
        if mapping.pwm_frequency is None:
            return np.zeros(len(block))
        numbers = _filled_forward(block.numbers[mapping.pwm_frequency.column])
        before = 0.0 if opened is None else opened.key[2]
        return np.where(np.isfinite(numbers), numbers, before)

    def _leave_out(self, path: Path, row: int, rows: int, label: str) -> None:
        self.leftover.rows += rows
        suffix = f", label {label!r}" if label else ""
        self.leftover.first = self.leftover.first or f"{path.name}, row {row + 1}{suffix}"


def _matching_rule(rules: Sequence[tuple[int, SegmentRule]], labels: Labels, time_s: Numbers) -> NDArray[np.intp]:
    """Index of the first rule that each row matches."""
    which = np.full(time_s.size, _NO_RULE, dtype=np.intp)
    stamps = _filled_forward(time_s) if any(rule.has_range for _, rule in rules) else time_s
    for index, rule in reversed(rules):
        by_name = np.array([rule.label is None or fnmatchcase(name, str(rule.label)) for name in labels.names])
        if not by_name.any():
            continue
        fits: NDArray[Any] = by_name[labels.codes]
        if rule.from_s is not None:
            fits = fits & (stamps >= rule.from_s)
        if rule.to_s is not None:
            fits = fits & (stamps < rule.to_s)
        which[fits] = index
    return which


def _filled_forward(time_s: Numbers) -> Numbers:
    """Numbers, each missing one replaced by the last before it: a later check reports missing time stamps."""
    known = np.where(np.isfinite(time_s), np.arange(time_s.size), 0)
    return time_s[np.maximum.accumulate(known)]


def _runs(which: NDArray[np.intp], codes: NDArray[np.intp], pwm: Numbers) -> list[tuple[int, int]]:
    """Start and end of each run of rows with one rule, one label and one PWM frequency."""
    if which.size == 0:
        return []
    ends = np.flatnonzero((np.diff(which) != 0) | (np.diff(codes) != 0) | (np.diff(pwm) != 0.0)) + 1
    edges = [0, *ends.tolist(), which.size]
    return list(pairwise(edges))
