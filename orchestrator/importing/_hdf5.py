"""HDF5 files as blocks of columns: ``log/ia``, ``log/data(:,3)`` (a column), ``log/table.ia`` (a field)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._source import (
    BLOCK_ROWS,
    Block,
    Source,
    Wanted,
    as_labels,
    as_numbers,
    guarded,
    require_columns,
    same_length,
)
from orchestrator.importing._stamps import dates_as_seconds
from protocols import InputError

_COLUMN = re.compile(r"(.+)\(:,([1-9]\d{0,5})\)")


def open_hdf5(path: Path, wanted: Wanted) -> Source:
    """Open an HDF5 file; rows are along the first axis."""
    return Source(guarded(path, "HDF5", lambda: _blocks(path, wanted)))


def _blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    import h5py

    with h5py.File(path, "r") as file:
        found = {name: _dataset(path, file, name) for name in wanted.all}
        rows = same_length(path, {name: int(node.shape[0]) for name, (node, _) in found.items()})
        for start in range(0, rows, BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            yield block_of(path, wanted, {name: _rows(node, which, part) for name, (node, which) in found.items()})


def block_of(path: Path, wanted: Wanted, columns: Mapping[str, NDArray[Any]]) -> Block:
    """Arrays of the same rows as a block: numbers, dates in seconds, and labels; raises `InputError`."""
    numbers = {name: as_numbers(path, name, columns[name]) for name in wanted.numbers}
    if wanted.dates is not None:
        dates = as_labels(columns[wanted.dates])
        numbers[wanted.dates] = dates_as_seconds(path, wanted.dates, dates.names)[dates.codes]
    return Block(numbers, None if wanted.label is None else as_labels(columns[wanted.label]))


def _dataset(path: Path, file: Any, name: str) -> tuple[Any, int | str | None]:
    """A dataset, and the index of a column or the name of a field."""
    import h5py

    plain = name
    which: int | str | None = None
    column = _COLUMN.fullmatch(name)
    if column is not None:
        plain, which = column[1], int(column[2]) - 1
    elif name not in file and "." in name:
        plain, _, which = name.rpartition(".")
    if plain not in file:
        require_columns(path, [name], list_datasets(file))
    node = file[plain]
    if not isinstance(node, h5py.Dataset):
        raise InputError(str(path), name, "is a group; name a dataset in it")
    if isinstance(which, str):
        require_columns(path, [which], node.dtype.names or ())
    elif isinstance(which, int) and (node.ndim != 2 or which >= node.shape[1]):
        raise InputError(str(path), name, f"the dataset has the shape {node.shape}")
    elif which is None and (node.ndim == 0 or node.shape[0] != np.prod(node.shape)):
        raise InputError(str(path), name, f"the dataset has the shape {node.shape}; name a column: {name}(:,1)")
    return node, which


def _rows(node: Any, which: int | str | None, part: slice) -> NDArray[Any]:
    if isinstance(which, str):
        return np.asarray(node[part][which])
    values = node[part] if which is None else node[part, which]
    return np.asarray(values).reshape(-1)


def list_datasets(file: Any, columns_along: int = 1, most: int = 1000) -> list[str]:
    """Names of all columns that a mapping could use.

    Parameters
    ----------
    columns_along : int
        Axis of a matrix's columns; 0 for MATLAB 7.3, which stores matrices transposed.
    most : int
        Largest number of columns to list per matrix, as a damaged file may state any shape.
    """
    import h5py

    found: list[str] = []

    def note(name: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or node.ndim == 0:
            return
        if node.dtype.names:
            found.extend(f"{name}.{field}" for field in node.dtype.names)
        elif node.ndim == 2 and node.shape[columns_along] > 1:
            found.extend(f"{name}(:,{k + 1})" for k in range(min(node.shape[columns_along], most)))
        else:
            found.append(name)

    file.visititems(note)
    return found
