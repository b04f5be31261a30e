"""Measurement files of every kind as blocks of named columns, in the file's own units; nothing is interpreted.

The readers differ in how much they hold: CSV, Parquet and MATLAB 7.3 hand out a block at a time, MATLAB 5 and MF4 load
the named columns whole.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator._validation import nearest
from orchestrator.formatting.sentences import one_line
from orchestrator.memory import require_memory
from protocols import InputError

Numbers = NDArray[np.float64]

BLOCK_ROWS = 1 << 16
TIMESTAMPS = "timestamps"
"""The column of a file's own raster [s], where its channels bring one."""


@dataclass(frozen=True)
class Labels:
    """One label a row: `names[codes[k]]`."""

    codes: NDArray[np.intp]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Block:
    """Consecutive rows; what is missing is NaN."""

    numbers: Mapping[str, Numbers]
    labels: Labels | None = None

    def __len__(self) -> int:
        return next(iter(self.numbers.values())).size


@dataclass(frozen=True)
class Wanted:
    """The columns that an import needs."""

    numbers: tuple[str, ...]
    label: str | None = None
    dates: str | None = None
    """A column of time stamps that are dates; it comes among the numbers, as seconds."""

    @property
    def all(self) -> tuple[str, ...]:
        """All of them, each once."""
        return tuple(dict.fromkeys((*self.numbers, *(x for x in (self.label, self.dates) if x is not None))))


@dataclass(frozen=True)
class Source:
    """An opened file: its blocks, and the units that it gives itself, where it does."""

    blocks: Iterable[Block]
    units: Mapping[str, str] = field(default_factory=dict)


def require_columns(path: Path, wanted: Iterable[str], present: Collection[str]) -> None:
    """Raise `InputError` where a wanted column is not there."""
    for name in wanted:
        if name not in present:
            if (apart := _unseparated(name, present)) is not None:
                problem = f"no such column, but in one that holds several: separated by {apart}? (csv: delimiter)"
                raise InputError(str(path), name, problem)
            near = nearest(name, present)
            choices = sorted(one_line(there)[:100] for there in present)
            if near is not None:
                raise InputError(str(path), name, f"no such column; did you mean {one_line(near)[:100]!r}?")
            inline = ", ".join(choices)
            if len(inline) <= 100:
                raise InputError(str(path), name, f"no such column; valid: {inline}")
            raise InputError(str(path), name, f"no such column; the file has {len(choices)}:", choices)


def as_numbers(path: Path, name: str, values: NDArray[Any]) -> Numbers:
    """A column as doubles; raises `InputError` where it holds no real numbers."""
    if values.dtype.kind not in "fiub":
        raise InputError(str(path), name, f"expected real numbers, got {values.dtype}")
    return np.ascontiguousarray(values, dtype=np.float64)


def as_labels(values: NDArray[Any]) -> Labels:
    """A column as labels; whole numbers are written without a decimal point."""
    if values.dtype.kind == "f":
        values = np.where(np.isfinite(values), values, np.nan)
    distinct, codes = np.unique(values, return_inverse=True)
    return Labels(codes.reshape(-1).astype(np.intp), tuple(map(_label, distinct.tolist())))


def same_length(path: Path, lengths: Mapping[str, int]) -> int:
    """The common length of columns; raises `InputError` where they differ."""
    first, expected = next(iter(lengths.items()))
    for name, length in lengths.items():
        if length != expected:
            raise InputError(str(path), name, f"has {length} samples, but {first} has {expected}")
    return expected


def guarded(path: Path, kind: str, blocks: Callable[[], Iterator[Block]]) -> Iterator[Block]:
    """The blocks, with whatever the reading library raises turned into an `InputError`.

    The libraries have no common base for what a damaged file makes them raise.
    """
    try:
        yield from blocks()
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise unreadable(path, kind, error) from None


def held(path: Path, blocks: Iterable[Block]) -> Iterator[Block]:
    """Blocks that are all kept; raises `RecordingError` before they are more than the machine has memory for."""
    rows = size = 0
    for block in blocks:
        rows, size = rows + len(block), size + sum(column.nbytes for column in block.numbers.values())
        require_memory(path, size, f"{rows} rows and more", held=size)
        yield block


def unreadable(path: Path, kind: str, error: Exception) -> InputError:
    """The one line for what a reading library raised."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(str(path), "", f"not a readable {kind} file: {reason}")


def whole(path: Path, source: Source) -> Block:
    """All rows of a source in one block; raises `InputError` where it has none."""
    blocks = list(held(path, source.blocks))
    if not blocks:
        raise InputError(str(path), "", "holds no row")
    names: Mapping[str, Numbers] = blocks[0].numbers
    numbers = {name: np.concatenate([block.numbers[name] for block in blocks]) for name in names}
    if blocks[0].labels is None:
        return Block(numbers)
    known: dict[str, int] = {}
    codes = [
        np.array([known.setdefault(name, len(known)) for name in block.labels.names], dtype=np.intp)[block.labels.codes]
        for block in blocks
        if block.labels is not None
    ]
    return Block(numbers, Labels(np.concatenate(codes), tuple(known)))


def _label(value: object) -> str:
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace").strip("\0 ")
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


def _unseparated(name: str, present: Collection[str]) -> str | None:
    """By what names look separated where a wanted one is but a part of one; None where it is no part."""
    for there in present:
        for apart, told in (("\t", "tabs"), (";", "semicolons"), (",", "commas"), ("|", "bars")):
            if apart in there and name in (part.strip().strip('"') for part in there.split(apart)):
                return told
    return None
