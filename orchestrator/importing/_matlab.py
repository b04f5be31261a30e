"""MATLAB's .mat files as blocks of columns: version 5 by scipy, version 7.3 by h5py.

A column is named as in MATLAB: ``ia``, ``log.ia`` (a struct's field), ``scope.signals(2).values`` (an element of a
struct array), ``data(:,3)`` (a matrix's column), ``ia.Data`` (of a timeseries), ``T.ia`` (of a table).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._hdf5 import block_of
from orchestrator.importing._matlab_objects import holds_objects, load_with_objects, member
from orchestrator.importing._source import BLOCK_ROWS, Block, Source, Wanted, guarded, require_columns, same_length
from orchestrator.validation.memory import require_memory
from protocols import InputError

_HEADER_BYTES, _TAG, _MATRIX, _COMPRESSED = 128, struct.Struct("II"), 14, 15
_CHUNK_BYTES = 1 << 20
"""Bytes to read or inflate at a time."""
_PART = re.compile(r"([A-Za-z]\w*)(?:\((:,)?([1-9]\d{0,8})\))?", re.ASCII)


@dataclass(frozen=True)
class _Step:
    """One part of a dotted name: a variable or field, with the index of an element or column (from 1)."""

    name: str
    element: int | None = None
    column: int | None = None


def open_matlab(path: Path, wanted: Wanted) -> Source:
    """A .mat file of version 5 or 7.3."""
    return Source(guarded(path, "MATLAB", lambda: _blocks(path, wanted)))


def _blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    import h5py

    is_hdf5 = h5py.is_hdf5(path)
    blocks = _object_blocks if holds_objects(path, is_hdf5) else _hdf5_blocks if is_hdf5 else _version_5_blocks
    return blocks(path, wanted)


def _steps(path: Path, name: str) -> list[_Step]:
    steps = []
    for part in name.split("."):
        found = _PART.fullmatch(part)
        if found is None:
            raise InputError(str(path), name, "expected a name as in MATLAB: ia, log.ia, log.ch(2).ia or data(:,3)")
        number = None if found[3] is None else int(found[3])
        steps.append(_Step(found[1], *((None, number) if found[2] else (number, None))))
    return steps


def _version_5_blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    from scipy.io import loadmat, whosmat

    steps = {name: _steps(path, name) for name in wanted.all}
    require_memory(path, inflated_size(path), "its variables")
    require_columns(path, [s[0].name for s in steps.values()], [entry[0] for entry in whosmat(path)])
    yield _arrays_block(path, wanted, loadmat(path, variable_names=_variables(steps)), steps)


def _object_blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    steps = {name: _steps(path, name) for name in wanted.all}
    yield _arrays_block(path, wanted, load_with_objects(path, _variables(steps)), steps)


def _variables(steps: Mapping[str, list[_Step]]) -> list[str]:
    return sorted({s[0].name for s in steps.values()})


def _arrays_block(path: Path, wanted: Wanted, variables: Any, steps: Mapping[str, list[_Step]]) -> Block:
    columns = {name: _in_arrays(path, name, variables, steps[name]) for name in wanted.all}
    same_length(path, {name: column.size for name, column in columns.items()})
    return _block(path, wanted, columns)


def _in_arrays(path: Path, name: str, variables: Any, steps: list[_Step]) -> NDArray[Any]:
    here: Any = variables
    for depth, step in enumerate(steps):
        here = member(path, here, step.name)
        if depth < len(steps) - 1 and isinstance(here, np.ndarray):
            _require_struct(path, name, step, here.dtype.names is not None)
            here = _element(path, name, here.reshape(-1, order="F"), step)
    if not isinstance(here, np.ndarray):
        raise InputError(str(path), name, f"is a MATLAB object; give a property of it, e.g. {name}.Data")
    return _vector(path, name, np.asarray(here), steps[-1])


def _hdf5_blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    import h5py

    with h5py.File(path, "r") as file:
        found = {name: _in_groups(path, name, file, _steps(path, name)) for name in wanted.all}
        rows = same_length(path, {name: _length(path, name, *where) for name, where in found.items()})
        for start in range(0, rows, BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            yield _block(path, wanted, {name: _slice(node, step, part) for name, (node, step) in found.items()})


def _in_groups(path: Path, name: str, file: Any, steps: list[_Step]) -> tuple[Any, _Step]:
    import h5py

    here: Any = file
    above: _Step | None = None
    for step in steps:
        if above is not None:
            _require_struct(path, name, above, isinstance(here, h5py.Group))
        require_columns(path, [step.name], list(here))
        here = here[step.name]
        if above is not None and isinstance(here, h5py.Dataset) and here.dtype == h5py.ref_dtype:
            # HDF5 stores a struct array as a group of fields; each field lists references to the values.
            here = file[_element(path, name, here[()].reshape(-1), above)]
        above = step
    if not isinstance(here, h5py.Dataset):
        raise InputError(str(path), name, "expected numbers, got a struct")
    return here, steps[-1]


def _require_struct(path: Path, name: str, step: _Step, is_struct: bool) -> None:
    if not is_struct:
        raise InputError(str(path), name, f"{step.name} is no struct")


def _element(path: Path, name: str, elements: NDArray[Any], step: _Step) -> Any:
    if elements.size != 1 and step.element is None:
        raise InputError(str(path), name, f"{step.name} has {elements.size} elements; say which: {step.name}(1)")
    if (step.element or 1) > elements.size:
        raise InputError(str(path), name, f"{step.name} has {elements.size} elements")
    return elements[(step.element or 1) - 1]


def _vector(path: Path, name: str, values: NDArray[Any], step: _Step) -> NDArray[Any]:
    if step.column is not None and values.ndim == 2:
        _check_column(path, name, values.shape[1], step.column)
        return values[:, step.column - 1]
    _check_vector(path, name, values.shape)
    return values.reshape(-1)


def _length(path: Path, name: str, node: Any, step: _Step) -> int:
    # MATLAB 7.3 stores a matrix transposed.
    if step.column is not None and len(node.shape) == 2:
        _check_column(path, name, node.shape[0], step.column)
        return int(node.shape[1])
    _check_vector(path, name, node.shape)
    return int(np.prod(node.shape))


def _slice(node: Any, step: _Step, part: slice) -> NDArray[Any]:
    if step.column is not None and len(node.shape) == 2:
        return np.asarray(node[step.column - 1, part])
    longest = int(np.argmax(node.shape))
    return np.asarray(node[tuple(part if axis == longest else 0 for axis in range(len(node.shape)))])


def _check_column(path: Path, name: str, columns: int, column: int) -> None:
    if column > columns:
        raise InputError(str(path), name, f"the matrix has {columns} columns")


def _check_vector(path: Path, name: str, shape: tuple[int, ...]) -> None:
    if not shape or max(shape) != np.prod(shape):
        size = " x ".join(map(str, shape))
        raise InputError(str(path), name, f"expected a vector, got {size or 'nothing'}; name a column: {name}(:,1)")


def _block(path: Path, wanted: Wanted, columns: dict[str, NDArray[Any]]) -> Block:
    for name in (wanted.label, wanted.dates):
        if name is not None and columns[name].dtype.kind == "O":  # a cell array of texts
            columns[name] = np.array(["".join(map(str, np.ravel(value))) for value in columns[name]])
    return block_of(path, wanted, columns)


def inflated_size(path: Path) -> int:
    """Inflated bytes of all variables of version 5; of a damaged file, those before the damage. Raises OSError.

    Each variable is compressed separately; a kilobyte may inflate to a megabyte (MathWorks, MAT-File Format, "Data
    Element Format"). Nothing is kept.
    """
    size = 0
    with path.open("rb") as file:
        order = ">" if file.read(_HEADER_BYTES)[-2:] == b"MI" else "<"
        while len(tag := file.read(_TAG.size)) == _TAG.size:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind not in (_MATRIX, _COMPRESSED) or length == 0:
                break  # no variable: the file is damaged, or has been filled up
            end = file.tell() + length
            size += _inflated(file, length) if kind == _COMPRESSED else length
            file.seek(end)
    return size


def _inflated(file: BinaryIO, length: int) -> int:
    inflating, size = zlib.decompressobj(), 0
    try:
        while length > 0 and (chunk := file.read(min(_CHUNK_BYTES, length))):
            length -= len(chunk)
            while chunk:
                size += len(inflating.decompress(chunk, _CHUNK_BYTES))
                chunk = inflating.unconsumed_tail
    except zlib.error:
        pass  # the reader of the variable reports the damage
    return size
