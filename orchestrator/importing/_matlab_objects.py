"""Read MATLAB objects by mat-io: timeseries (``ia.Data``, ``ia.Time``) and tables (``T.ia``).

MathWorks does not document the file format of objects; mat-io implements it.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._source import require_columns
from protocols import InputError

_SUBSYSTEM = slice(116, 124)
"""Bytes of a version 5 header that point to the objects."""


def holds_objects(path: Path, is_hdf5: bool) -> bool:
    """Whether a .mat file holds objects."""
    if is_hdf5:
        import h5py

        with h5py.File(path, "r") as file:
            return "#subsystem#" in file
    with path.open("rb") as file:
        return bool(file.read(128)[_SUBSYSTEM].strip(b"\0 "))


def load_with_objects(path: Path, names: Sequence[str]) -> dict[str, Any]:
    """The named variables; raises `InputError` where mat-io or a variable is missing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pandas, about options that mat-io sets
            from matio import load_from_mat, whosmat
    except ImportError as error:
        problem = f"holds MATLAB objects, which are read by mat-io: pip install 'fluxbench[matlab]' ({error})"
        raise InputError(str(path), "", problem) from None
    require_columns(path, names, list(whosmat(str(path))))
    return dict(load_from_mat(str(path), variable_names=list(names)))


def member(path: Path, holder: Any, name: str) -> Any:
    """A variable of a file, a field of a struct, a property of an object, a column of a table; raises `InputError`."""
    if isinstance(holder, dict | np.ndarray | np.void):
        require_columns(path, [name], holder if isinstance(holder, dict) else holder.dtype.names or ())
        return holder[name]
    if hasattr(holder, "columns"):
        require_columns(path, [name], [str(column) for column in holder.columns])
        return holder[name].to_numpy()
    properties = dict(getattr(holder, "properties", {}))
    if name == "Time" and "TimeInfo" in properties and not np.size(properties.get("Time_", ())):
        info = properties["TimeInfo"].properties
        start, step, length = (float(np.ravel(info[key])[0]) for key in ("Start_", "Increment_", "Length"))
        return start + step * np.arange(int(length))
    # MATLAB stores the property Data as Data_.
    require_columns(path, [name], [key.removesuffix("_") for key in properties])
    return properties.get(name, properties.get(f"{name}_"))
