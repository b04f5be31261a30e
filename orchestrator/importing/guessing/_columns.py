"""List the columns of a measurement file of any kind, with the units that the file states."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._hdf5 import list_datasets
from orchestrator.importing._matlab import inflated_size
from orchestrator.importing._source import TIMESTAMPS
from orchestrator.importing.guessing._layout import TextLayout, text_layout
from orchestrator.importing.guessing._units import names_and_units, unit_of
from orchestrator.validation.memory import require_memory
from protocols import InputError

_OF_MAPS = (".npz", ".nc", ".json")
"""Endings of files with flux maps instead of waveforms."""


@dataclass(frozen=True)
class Columns:
    """Column names, units by name as stated in the file, and the layout of a text file."""

    names: list[str]
    units: dict[str, str] = field(default_factory=dict)
    layout: TextLayout | None = None
    called: dict[str, str] = field(default_factory=dict)
    """Descriptions from the file, where a column's name is only its place (dSPACE)."""


def columns_of(path: Path) -> Columns:
    """List a file's columns; raises `InputError` for an unknown kind or a damaged file."""
    ending = path.suffix.lower()
    try:
        if ending in (".csv", ".tsv", ".txt"):
            layout = text_layout(path)
            return _with_units(list(layout.names), layout.units, layout)
        if ending in (".parquet", ".pq"):
            import pyarrow.parquet as pq

            return _with_units(list(pq.read_schema(path).names), {})
        if ending in (".h5", ".hdf5", ".hdf", ".mat"):
            called = _of_hdf5_or_mat(path)
            return replace(_with_units(list(called), {}), called={n: text for n, text in called.items() if text != n})
        if ending == ".tdms":
            return _of_tdms(path)
    except InputError:
        raise
    except Exception as error:  # the libraries have no common base class for errors of damaged files
        reason = " ".join(str(error).split())[:200]
        raise InputError(str(path), "", f"cannot be read: {reason or type(error).__name__}") from None
    problem = "--guess knows text, Parquet, MATLAB, HDF5 and TDMS files only"
    if ending in _OF_MAPS:
        problem += f"; `fluxbench audit {path.name}` checks a flux map"
    raise InputError(str(path), "", problem)


def variables_of(names: Sequence[str]) -> list[str]:
    """The names of variables, each once: ``flux(:,3)`` is a column of ``flux``."""
    return list(dict.fromkeys(re.sub(r"\(:,\d+\)$", "", name) for name in names))


def _with_units(names: list[str], units: dict[str, str], layout: TextLayout | None = None) -> Columns:
    in_names = {name: unit for name, (_, unit) in names_and_units(names).items() if unit is not None}
    return Columns(names, in_names | {name: unit for name, unit in units.items() if unit}, layout)


def _of_hdf5_or_mat(path: Path) -> dict[str, str]:
    """Column names, each with the file's description."""
    import h5py

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            is_matlab = path.suffix.lower() == ".mat"
            names = [name for name in list_datasets(file, 0 if is_matlab else 1) if not name.startswith("#")]
        names = [name.replace("/", ".") for name in names] if is_matlab else names
        return {name: name for name in names}
    from scipy.io import loadmat

    require_memory(path, inflated_size(path), "its variables")
    variables = loadmat(path)
    return dict(pair for key, value in variables.items() if not key.startswith("__") for pair in _in_matlab(key, value))


def _in_matlab(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if not isinstance(value, np.ndarray):
        return
    fields = value.dtype.names or ()
    if "Data" in fields and (value.size > 1 or "Name" in fields):
        # ControlDesk of dSPACE: X.Data is the time, Y(k).Data a signal called Y(k).Name.
        for k, one in enumerate(value.reshape(-1, order="F"), start=1):
            place = f"{name}({k}).Data" if value.size > 1 else f"{name}.Data"
            yield place, "".join(map(str, np.ravel(one["Name"]))) if "Name" in fields else place
    elif fields and value.size == 1:
        for part in fields:
            if part == "X" and "Y" in fields and "Data" in (value[part].item().dtype.names or ()):
                yield f"{name}.X.Data", "time"
            else:
                yield from _in_matlab(f"{name}.{part}", value[part].item())
    elif value.dtype.kind in "fiu" and value.size > 1:
        if max(value.shape) == value.size:
            yield name, name
        elif value.ndim == 2:
            yield from ((f"{name}(:,{k + 1})",) * 2 for k in range(value.shape[1]))
        else:
            yield name, name


def _of_tdms(path: Path) -> Columns:
    from nptdms import TdmsFile

    with TdmsFile.read_metadata(path) as file:
        channels = {f"{group.name}/{one.name}": one for group in file.groups() for one in group.channels()}
        units = {n: unit_of(str(c.properties.get("unit_string", ""))) or "" for n, c in channels.items()}
        tracked = any("wf_increment" in c.properties for c in channels.values())
    return _with_units([*channels, *([TIMESTAMPS] if tracked else [])], units)
