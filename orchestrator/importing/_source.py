"""Read measurement files as blocks of named columns in the file's own units, without interpretation.

CSV, Parquet and MATLAB 7.3 are read block by block; MATLAB 5 and MF4 readers load the named columns as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.formatting.sentences import one_line
from orchestrator.validation.memory import require_memory
from orchestrator.validation.messages import nearest
from protocols import InputError

Numbers = NDArray[np.float64]

BLOCK_ROWS = 1 << 16
TIMESTAMPS = "timestamps"
"""Name of the column of a file's own time raster [s]."""


@dataclass(frozen=True)
class Labels:
    """One label per row: `names[codes[k]]`."""

    codes: NDArray[np.intp]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Block:
    """Consecutive rows; missing values are NaN."""

    numbers: Mapping[str, Numbers]
    labels: Labels | None = None

    def __len__(self) -> int:
        return next(iter(self.numbers.values())).size


@dataclass(frozen=True)
class Wanted:
    """Names of the columns that an import needs."""

    numbers: tuple[str, ...]
    label: str | None = None
    dates: str | None = None
    """A column of dates as time stamps; blocks hold it among the numbers, in seconds."""

    @property
    def all(self) -> tuple[str, ...]:
        """All columns, each once."""
        return tuple(dict.fromkeys((*self.numbers, *(x for x in (self.label, self.dates) if x is not None))))


@dataclass(frozen=True)
class Source:
    """An opened file: its blocks, and the units that the file states."""

    blocks: Iterable[Block]
    units: Mapping[str, str] = field(default_factory=dict)


def require_columns(path: Path, wanted: Iterable[str], present: Collection[str]) -> None:
    """Raise `InputError` where a wanted column is missing."""
    for name in wanted:
        if name not in present:
            if (apart := _unseparated(name, present)) is not None:
                problem = f"no such column, but in one that holds several: separated by {apart[0]}? (csv: {apart[1]})"
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
    """The blocks; any error of the reading library becomes an `InputError`.

    The libraries have no common base class for errors of damaged files.
    """
    try:
        yield from blocks()
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise unreadable(path, kind, error) from None


def held(path: Path, blocks: Iterable[Block]) -> Iterator[Block]:
    """All blocks as a list; raises `RecordingError` before they exceed the memory of the machine."""
    rows = size = 0
    for block in blocks:
        rows, size = rows + len(block), size + sum(column.nbytes for column in block.numbers.values())
        require_memory(path, size, f"{rows} rows and more", held=size)
        yield block


def unreadable(path: Path, kind: str, error: Exception) -> InputError:
    """An `InputError` of one line for an error of a reading library."""
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


def _unseparated(name: str, present: Collection[str]) -> tuple[str, str] | None:
    """The delimiter that would split a present name into the wanted one, and its entry in a mapping; None without."""
    for there in present:
        for delimiter, words in (("\t", "tabs"), (";", "semicolons"), (",", "commas"), ("|", "bars")):
            if delimiter in there and name in (part.strip().strip('"') for part in there.split(delimiter)):
                written = '"\\t"' if delimiter == "\t" else f"'{delimiter}'"
                return words, f"{{delimiter: {written}}}"
    return None
