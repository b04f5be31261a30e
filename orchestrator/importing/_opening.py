"""Choose a file's reader by the ending of its name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from orchestrator.importing._columnar import open_csv, open_parquet
from orchestrator.importing._hdf5 import open_hdf5
from orchestrator.importing._mapping import CsvLayout, ImportMapping
from orchestrator.importing._matlab import open_matlab
from orchestrator.importing._recorders import open_comtrade, open_mf4, open_tdms
from orchestrator.importing._source import Block, Numbers, Source, Wanted, held
from protocols import InputError

Reader = Callable[[Path, Wanted], Source]

_TEXT = (".csv", ".tsv", ".txt")
_READERS: dict[str, Reader] = {
    **dict.fromkeys((".parquet", ".pq"), open_parquet),
    **dict.fromkeys((".mat",), open_matlab),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), open_hdf5),
    **dict.fromkeys((".mf4", ".mdf"), open_mf4),
    **dict.fromkeys((".tdms",), open_tdms),
    **dict.fromkeys((".cfg", ".cff"), open_comtrade),
}
ENDINGS = (*_TEXT, *_READERS)
"""Endings of readable files, in lower case."""


def open_source(
    path: Path,
    mapping: ImportMapping,
    names: Mapping[str, str] | None = None,
    *,
    only: Collection[str] | None = None,
    without: Collection[str] = (),
) -> Source:
    """Open a measurement file for the columns of a mapping.

    Parameters
    ----------
    names : mapping, optional
        Column names in the file, by their names in the mapping.
    only, without : collection, optional
        Columns to read in addition to the time stamps; columns to leave out.

    Raises
    ------
    InputError
        Where the file or a column in it cannot be read.
    """
    dates = mapping.time.column if mapping.time is not None and mapping.time.unit == "iso" else None
    clock = mapping.time.column if mapping.time is not None and dates is None else None
    numbers = [n for n in mapping.number_columns() if n not in without and (only is None or n in only or n == clock)]
    called = {name: (names or {}).get(name, name) for name in (*numbers, mapping.segment_column, dates) if name}
    label = mapping.segment_column if only is None else None
    wanted = Wanted(
        tuple(dict.fromkeys(called[name] for name in numbers)),
        None if label is None else called[label],
        None if dates is None else called[dates],
    )
    source = open_columns(path, wanted, mapping.csv)
    if all(name == there for name, there in called.items()):
        return source
    units = {name: source.units[there] for name, there in called.items() if there in source.units}
    blocks = (
        Block({name: block.numbers[there] for name, there in called.items() if there in block.numbers}, block.labels)
        for block in source.blocks
    )
    return Source(blocks, units)


def open_columns(path: Path, wanted: Wanted, layout: CsvLayout) -> Source:
    """Open a measurement file by its own column names; raises `InputError`."""
    ending = path.suffix.lower()
    try:
        if ending in _TEXT:
            return open_csv(path, wanted, layout)
        if ending in _READERS:
            return _READERS[ending](path, wanted)
    except OSError as error:  # libraries do not name the file
        raise InputError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    raise InputError(str(path), "", f"unknown kind of file; known: {', '.join(ENDINGS)}")


def read_table(path: Path, names: Sequence[str], layout: CsvLayout) -> dict[str, Numbers]:
    """Columns of a Parquet file, or of a text file with the given layout; raises `InputError`."""
    wanted = Wanted(tuple(dict.fromkeys(names)))
    is_parquet = path.suffix.lower() in (".parquet", ".pq")
    source = open_parquet(path, wanted) if is_parquet else open_csv(path, wanted, layout)
    blocks = list(held(path, source.blocks))
    return {name: np.concatenate([block.numbers[name] for block in blocks] or [np.empty(0)]) for name in wanted.all}


def check_file(path: Path) -> None:
    """Raise `InputError` where `path` is not a readable file."""
    try:
        if not path.is_file():
            raise InputError(str(path), "", "no such file")
        with path.open("rb"):
            pass
    except (OSError, ValueError) as error:
        raise InputError(repr(str(path)), "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
