"""Any table of a flux map by a mapping: a YAML file with its name and the meaning of its columns. Judges nothing.

The keys are those of a recording's mapping (docs/import.md). Columns are columns of CSV and Parquet files; in .npz and
.mat files they are arrays: all of one shape, or axes and tables over them (`_tables`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import ValidationError, model_validator

from orchestrator.flux_maps._arrays import READERS
from orchestrator.flux_maps._gridding import TORQUE, MapFile, gridded
from orchestrator.flux_maps._ripple import mean_over_angle
from orchestrator.flux_maps._tables import as_points
from orchestrator.importing import FACTORS, TO_PEAK, Column, CsvLayout, CurrentUnit, NotZero, Scaling, read_table
from orchestrator.importing.guessing import roles_of_map
from orchestrator.numerics.types import Array
from orchestrator.validation.messages import first_problem
from orchestrator.validation.plain_files import read_text
from orchestrator.validation.strict_yaml import Document, parse_document
from protocols import InputError, ProcedureError, ProcedureMotor, Strict

FluxUnit = Literal["Wb", "mWb", "uWb", "Vs", "mVs", "uVs"]
TorqueUnit = Literal["Nm", "mNm", "kNm"]
AngleUnit = Literal["rad", "deg", "turn"]
_PREFIXES = {"m": 1e-3, "u": 1e-6, "k": 1e3}
_MAX_VALUE = 1e12
"""Largest value in any unit: microamperes of a megaampere."""
_QUARTER_RAD = 0.5 * np.pi


class _Vector(Strict):
    scaling: Scaling = "amplitude_invariant"
    factor: NotZero = 1.0
    """Factor that converts the columns to `unit`."""


class CurrentAngle(Strict):
    """The direction of a current that is given by its amplitude and angle."""

    unit: AngleUnit
    zero: Literal["d", "q"] = "d"
    """The axis at angle zero. It counts from d to q, and on to -d: from q it is the phase advance."""
    factor: NotZero = 1.0
    """-1 where the angle counts the other way."""


class MappedCurrent(_Vector):
    """Currents, on the axes or as a vector's amplitude and angle."""

    columns: dict[Literal["d", "q", "amplitude", "angle"], Column]
    unit: CurrentUnit
    angle: CurrentAngle | None = None

    @model_validator(mode="after")
    def _both(self) -> Self:
        if set(self.columns) not in ({"d", "q"}, {"amplitude", "angle"}):
            columns = ", ".join(self.columns) or "none"
            raise ValueError(f"expected columns for d and q, or for amplitude and angle, got {columns}")
        if ("angle" in self.columns) != (self.angle is not None):
            raise ValueError("columns amplitude and angle need angle, such as {unit: deg, zero: q}")
        return self


class MappedFlux(_Vector):
    """Flux linkages."""

    columns: dict[Literal["d", "q"], Column]
    unit: FluxUnit

    @model_validator(mode="after")
    def _both(self) -> Self:
        if len(self.columns) != 2:
            raise ValueError(f"expected columns for d and q, got {', '.join(self.columns) or 'none'}")
        return self


class MappedTorque(Strict):
    """Torque that was measured, or not computed from the flux linkages."""

    column: Column
    unit: TorqueUnit
    factor: NotZero = 1.0


class MappedRotorAngle(Strict):
    """The rotor angle of the tables, over which the map is their mean."""

    column: Column
    unit: AngleUnit
    mechanical: bool = False
    """Whether it is the shaft's angle; the electrical one is the pole pairs times it."""


class MapMapping(Strict):
    """The content of a mapping file."""

    format: Literal["fluxbench-map"]
    version: Literal[1]
    file: str
    """The table, beside the mapping."""
    current: MappedCurrent
    flux: MappedFlux
    torque: MappedTorque | None = None
    rotor_angle: MappedRotorAngle | None = None
    axes: tuple[Literal["d", "q", "amplitude", "angle", "theta"], ...] | None = None
    """The tables' dimensions, rows first, where their lengths are ambiguous; theta is the rotor angle."""
    magnet_axis: Literal["d", "-q"] = "d"
    """The magnet's axis in the file; -q with the axes of reluctance machines."""
    motor: ProcedureMotor | None = None
    """The motor, for its pole pairs, as in a procedure."""
    csv: CsvLayout = CsvLayout()

    @model_validator(mode="after")
    def _poles_for_the_shaft(self) -> Self:
        if self.rotor_angle is not None and self.rotor_angle.mechanical and self.motor is None:
            raise ValueError("rotor_angle: mechanical needs motor, with its pole_pairs")
        return self

    def names(self) -> list[str]:
        """The columns, each once."""
        further = [one.column for one in (self.torque, self.rotor_angle) if one is not None]
        return list(dict.fromkeys((*self.current.columns.values(), *self.flux.columns.values(), *further)))


def read_mapped(path: Path) -> MapFile:
    """The map in the table that a mapping names, peak values in SI units, magnet on d.

    Raises
    ------
    InputError
        With one line: file and line, key, problem.
    """
    mapping = _mapping(path)
    table = path.parent / mapping.file
    if not table.is_file():
        raise InputError(str(path), "file", f"no such file: {table}")
    return read_table_by(table, mapping)


def read_table_by(table: Path, mapping: MapMapping) -> MapFile:
    """The map in a table; raises `InputError`."""
    arrays = READERS.get(table.suffix.lower())
    if arrays is None:
        return map_of(str(table), mapping, read_table(table, mapping.names(), mapping.csv))
    content = arrays(table)
    mapping = mapping if mapping.rotor_angle is not None else _with_rotor_angle(mapping, content)
    return map_of(str(table), mapping, chosen_arrays(table, content, mapping.names()))


def map_of(where: str, mapping: MapMapping, found: Mapping[str, Array]) -> MapFile:
    """The map of columns by a mapping; raises `InputError`."""
    for name, values in found.items():
        if np.isinf(values).any() or not np.all(np.abs(values[np.isfinite(values)]) < _MAX_VALUE):
            raise InputError(where, name, "too large for a motor")
    current, flux = mapping.current.columns, mapping.flux.columns
    tables = [mapping.torque.column] if mapping.torque else []
    inverse = all(_is_line(found[name]) for name in flux.values()) and not any(
        found[name].size in {found[other].size for other in flux.values()} for name in current.values()
    )
    axes: dict[str, str] = {str(axis): name for axis, name in (flux if inverse else current).items()}
    tables += (current if inverse else flux).values()
    if mapping.rotor_angle is not None:
        axes["theta"] = mapping.rotor_angle.column
    points, remark = as_points(where, found, axes, tables, lambda columns: _vectors(mapping, columns), mapping.axes)
    i_dq, psi_dq = _vectors(mapping, points)
    columns = {"i_d": i_dq[:, 0], "i_q": i_dq[:, 1], "psi_d": psi_dq[:, 0], "psi_q": psi_dq[:, 1]}
    if mapping.torque is not None:
        columns[TORQUE] = points[mapping.torque.column] * mapping.torque.factor * _factor(mapping.torque.unit)
    if inverse:  # where the map does not reach, an inverse table has no current
        known = np.isfinite(i_dq).all(axis=1)
        columns = {name: values[known] for name, values in columns.items()}
    remarks = [] if remark is None else [remark]
    if mapping.rotor_angle is not None:
        angle = mapping.rotor_angle
        pole_pairs = mapping.motor.pole_pairs if angle.mechanical and mapping.motor is not None else 1
        if not np.isfinite(points[angle.column]).all():
            raise InputError(where, angle.column, "an angle is not finite")
        turned_rad = points[angle.column] * FACTORS[angle.unit] * pole_pairs
        columns, ripple = mean_over_angle(where, columns, turned_rad)
        remarks.append(ripple)
    return gridded(where, "mapped", columns, remarks)


def _mapping(path: Path) -> MapMapping:
    try:
        document: Document = parse_document(read_text(path), str(path))
    except ProcedureError as error:
        raise InputError(error.where, error.field, error.problem) from None
    if document.data.get("format") == "fluxbench-import":
        raise InputError(
            str(path), "format", "the mapping of waveforms, not of a flux map: `fluxbench import` reads it"
        )
    try:
        return MapMapping.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        problem = first_problem(error, MapMapping, document.data)
    raise InputError(document.place(problem.path), ".".join(map(str, problem.path)), problem.text)


def chosen_arrays(path: Path, content: Mapping[str, Any], names: Sequence[str]) -> dict[str, Array]:
    """Arrays by name; ``motor.psi_d`` is a field of a struct. Raises `InputError` for a missing one."""
    arrays: dict[str, Array] = {}
    for name in names:
        here: Any = content
        for part in name.split("."):
            here = here.get(part) if isinstance(here, Mapping) else None
        if not isinstance(here, np.ndarray) or here.dtype.kind not in "fiu":
            held = ", ".join(str(key) for key in content if not str(key).startswith("__"))
            raise InputError(str(path), name, f"no such array of numbers; the file has {held or 'none'}")
        arrays[name] = here.astype(np.float64)
    return arrays


def _with_rotor_angle(mapping: MapMapping, content: Mapping[str, Any]) -> MapMapping:
    """The mapping with the rotor angle that tables of three dimensions go over, where the file has one by its name."""
    table = next((content[name] for name in mapping.flux.columns.values() if name in content), None)
    if not isinstance(table, np.ndarray) or table.ndim != 3:
        return mapping
    sizes = {name: value.size for name, value in content.items() if isinstance(value, np.ndarray) and _is_line(value)}
    name = roles_of_map(
        [name for name, size in sizes.items() if size in table.shape and name not in mapping.names()]
    ).theta
    if name is None:
        problem = f"tables of shape {table.shape}: name their third axis, rotor_angle: {{column: NAME, unit: deg}}"
        raise InputError(mapping.file, "rotor_angle", problem)
    unit = angle_unit(np.asarray(content[name], dtype=np.float64))
    return mapping.model_copy(update={"rotor_angle": MappedRotorAngle(column=name, unit=unit)})


def angle_unit(values: Array) -> Literal["rad", "deg"]:
    """Degrees, where angles go beyond a turn in radians."""
    return "deg" if float(np.nanmax(np.abs(values))) > 2.0 * np.pi + 1e-3 else "rad"


def _is_line(values: Array) -> bool:
    return max(values.shape, default=0) == values.size


def _vectors(mapping: MapMapping, columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """Currents and flux linkages of points on PM axes, shape (n, 2)."""
    current, flux = mapping.current, mapping.flux
    if current.angle is None:
        i_d, i_q = (columns[current.columns[axis]] for axis in ("d", "q"))
    else:
        turned = columns[current.columns["angle"]] * current.angle.factor * FACTORS[current.angle.unit]
        turned = turned + (_QUARTER_RAD if current.angle.zero == "q" else 0.0)
        amplitude = columns[current.columns["amplitude"]]
        i_d, i_q = amplitude * np.cos(turned), amplitude * np.sin(turned)
    i_dq = np.column_stack((i_d, i_q)) * (TO_PEAK[current.scaling] * current.factor * FACTORS[current.unit])
    psi_dq = np.column_stack([columns[flux.columns[axis]] for axis in ("d", "q")])
    psi_dq = psi_dq * (TO_PEAK[flux.scaling] * flux.factor * _factor(flux.unit))
    if mapping.magnet_axis == "d":
        return i_dq, psi_dq
    return _turned(i_dq), _turned(psi_dq)


def _turned(vectors: Array) -> Array:
    """From the axes of a reluctance machine to those of a magnet on d."""
    return np.column_stack((-vectors[:, 1], vectors[:, 0]))


def _factor(unit: str) -> float:
    return _PREFIXES[unit[0]] if unit[0] in _PREFIXES and len(unit) > 2 else 1.0
