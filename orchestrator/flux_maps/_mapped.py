"""Any table of a flux map by a mapping: a YAML file that names it, and says which column is what. Judges nothing.

The words are those of a recording's mapping (docs/import.md). Columns are columns of CSV and Parquet files; in .npz and
.mat files they are arrays: all of one shape, or the currents as axes and the fluxes as tables over them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import ValidationError, model_validator

from orchestrator._document import Document, parse_document
from orchestrator._validation import first_problem
from orchestrator.flux_maps._arrays import mat_arrays, npz_arrays
from orchestrator.importing import FACTORS, TO_PEAK, Column, CsvLayout, CurrentUnit, NotZero, Scaling, read_table
from orchestrator.numerics.types import Array
from orchestrator.plain_files import read_text
from protocols import InputError, ProcedureError, ProcedureMotor, Strict

FluxUnit = Literal["Wb", "mWb", "uWb", "Vs", "mVs", "uVs"]
TorqueUnit = Literal["Nm", "mNm", "kNm"]
_PREFIXES = {"m": 1e-3, "u": 1e-6, "k": 1e3}
_ARRAYS = {".npz": npz_arrays, ".mat": mat_arrays}


class _Vector(Strict):
    columns: dict[Literal["d", "q"], Column]
    scaling: Scaling = "amplitude_invariant"
    factor: NotZero = 1.0
    """What the columns are multiplied by to be in `unit`."""

    @model_validator(mode="after")
    def _both(self) -> Self:
        if len(self.columns) != 2:
            raise ValueError(f"expected columns for d and q, got {', '.join(self.columns) or 'none'}")
        return self


class MappedCurrent(_Vector):
    """Currents."""

    unit: CurrentUnit


class MappedFlux(_Vector):
    """Flux linkages."""

    unit: FluxUnit


class MappedTorque(Strict):
    """Torque that was measured, or computed otherwise than from the flux linkages."""

    column: Column
    unit: TorqueUnit
    factor: NotZero = 1.0


class MapMapping(Strict):
    """A mapping file, whole."""

    format: Literal["fluxbench-map"]
    version: Literal[1]
    file: str
    """The table, beside the mapping."""
    current: MappedCurrent
    flux: MappedFlux
    torque: MappedTorque | None = None
    magnet_axis: Literal["d", "-q"] = "d"
    """Where the file's axes have the magnet; -q are the axes of reluctance machines."""
    motor: ProcedureMotor | None = None
    """For whoever needs the pole pairs; a section of its own, as in a procedure."""
    csv: CsvLayout = CsvLayout()


def read_mapped(path: Path) -> tuple[str, dict[str, Array]]:
    """The columns of the table that a mapping names, in SI units, peak values, magnet on d, by our own names.

    Raises
    ------
    InputError
        One line: file and line, key, what is wrong.
    """
    mapping = _mapping(path)
    names = [*mapping.current.columns.values(), *mapping.flux.columns.values()]
    names += [mapping.torque.column] if mapping.torque else []
    table = path.parent / mapping.file
    if not table.is_file():
        raise InputError(str(path), "file", f"no such file: {table}")
    arrays = _ARRAYS.get(table.suffix.lower())
    found = read_table(table, names, mapping.csv) if arrays is None else _chosen(table, arrays(table), names)
    found = _over_axes(str(table), mapping, found)
    i_d, i_q = _vector(mapping.current, found, FACTORS[mapping.current.unit])
    psi_d, psi_q = _vector(mapping.flux, found, _factor(mapping.flux.unit))
    if mapping.magnet_axis == "-q":
        i_d, i_q, psi_d, psi_q = -i_q, i_d, -psi_q, psi_d
    columns = {"i_d": i_d, "i_q": i_q, "psi_d": psi_d, "psi_q": psi_q}
    if mapping.torque is not None:
        columns["torque_nm"] = found[mapping.torque.column] * mapping.torque.factor * _factor(mapping.torque.unit)
    return "mapped", columns


def _mapping(path: Path) -> MapMapping:
    try:
        document: Document = parse_document(read_text(path), str(path))
    except ProcedureError as error:
        raise InputError(error.where, error.field, error.problem) from None
    try:
        return MapMapping.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        problem = first_problem(error, MapMapping, document.data)
    raise InputError(document.place(problem.path), ".".join(map(str, problem.path)), problem.text)


def _chosen(path: Path, content: Mapping[str, Any], names: Sequence[str]) -> dict[str, Array]:
    """Arrays by name; ``motor.psi_d`` is a field of a struct."""
    found: dict[str, Array] = {}
    for name in names:
        here: Any = content
        for part in name.split("."):
            here = here.get(part) if isinstance(here, Mapping) else None
        if not isinstance(here, np.ndarray) or here.dtype.kind not in "fiu":
            held = ", ".join(str(key) for key in content if not str(key).startswith("__"))
            raise InputError(str(path), name, f"no such array of numbers; the file has {held or 'none'}")
        found[name] = here.astype(np.float64)
    return found


def _over_axes(where: str, mapping: MapMapping, found: dict[str, Array]) -> dict[str, Array]:
    """Arrays of one shape: currents that are axes become tables, as the fluxes are."""
    d, q = (mapping.current.columns[axis] for axis in ("d", "q"))
    flux = found[mapping.flux.columns["d"]]
    axes = found[d].ravel(), found[q].ravel()
    if found[d].shape == flux.shape:
        return found
    if flux.ndim != 2 or sorted(flux.shape) != sorted(map(len, axes)):
        sizes = f"{found[d].shape}, {found[q].shape} and {flux.shape}"
        raise InputError(where, f"{d}, {q}", f"currents and fluxes of shapes {sizes} do not go together")
    rows_along_d = flux.shape == (len(axes[0]), len(axes[1]))
    if rows_along_d and len(axes[0]) == len(axes[1]):
        raise InputError(where, f"{d}, {q}", "axes of one length do not tell the rows from the columns: give tables")
    i_d, i_q = np.meshgrid(*axes, indexing="ij" if rows_along_d else "xy")
    return found | {d: i_d, q: i_q}


def _vector(signal: _Vector, found: dict[str, Array], unit: float) -> tuple[Array, Array]:
    scale = TO_PEAK[signal.scaling] * signal.factor * unit
    return found[signal.columns["d"]] * scale, found[signal.columns["q"]] * scale


def _factor(unit: str) -> float:
    return _PREFIXES[unit[0]] if unit[0] in _PREFIXES and len(unit) > 2 else 1.0
