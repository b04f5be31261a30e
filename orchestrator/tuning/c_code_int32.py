"""The C source in int32, for cores without floats: the float source's tables in integer units. Decides no value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.tuning.c_code import WHERE, Table, rendered, rows_of
from protocols import InputError

LARGEST = 2**31 - 1
PART_BITS = 16
"""Of a step between two nodes."""
FACTOR_BITS = 30
"""Of a factor: times a number of 33 bits it stays within 64."""
MAX_SHIFT = 62
TURN32_PER_RAD = 2.0**32 / (2.0 * math.pi)
MICRO, NANO = 1e6, 1e9
"""Units in one of SI."""
VALUES_PER_SI: Mapping[str, tuple[float, ...]] = {
    "psi_table": (NANO,),
    "inductance_table": (NANO,),
    "torque_limit_table": (MICRO,),
    "reference_table": (MICRO,),
    "lost_table": (MICRO, 2.0**30),
}
"""Of each table, for the numbers of an entry in their order."""
AXES_PER_SI: Mapping[str, float] = {"LIMIT": NANO} | dict.fromkeys(("PSI_D", "PSI_Q", "L_D", "L_Q", "PHASE"), MICRO)


@dataclass(frozen=True)
class _Axis:
    name: str
    count: int
    first: int
    last: int
    steps: float
    """2^16 steps per unit; zero where the source has no values of the axis."""


@dataclass(frozen=True)
class _Int32Table:
    meaning: str
    axes: tuple[_Axis, ...]
    values: NDArray[np.int64]


def c_files_int32(values: Mapping[str, Any]) -> dict[str, bytes]:
    """Header and source in int32, by file name: `<symbol>_drive_int32.h` and `.c`; from `source_values`.

    Raises
    ------
    InputError
        Where a quantity exceeds int32: 2147 A, V, Nm or ohm, and 2.1 Wb or H.
    """
    tables = {name: _in_int32(name, table) for name, table in values["tables"].items()}
    turn32 = round(values["angle_rad"] * TURN32_PER_RAD) % 2**32
    filled = {**values, "tables": tables, "turn32": turn32, "turn32_per_rad": TURN32_PER_RAD}
    filters: dict[str, Callable[..., Any]] = {
        "factor": _factor,
        "units": _units,
        "rows": lambda table: rows_of(map(str, table.flat)),
    }
    names = {kind: f"{values['p']}_drive_int32.{kind}" for kind in ("h", "c")}
    return {name: rendered(f"drive_int32.{kind}.j2", filled, filters) for kind, name in names.items()}


def _in_int32(name: str, table: Table) -> _Int32Table:
    per_si = np.array(VALUES_PER_SI[name])
    axes = tuple(_axis(axis, nodes) for axis, nodes in table.axes.items())
    return _Int32Table(table.meaning, axes, _integers(name, table.values * per_si))


def _axis(name: str, nodes: Array) -> _Axis:
    per_si = AXES_PER_SI.get(name)
    if per_si is None:
        return _Axis(name, len(nodes), 0, 0, 0.0)
    first, last = _integers(name.lower(), nodes[[0, -1]] * per_si).tolist()
    return _Axis(name, len(nodes), first, last, 2.0**PART_BITS * (len(nodes) - 1) / (last - first))


def _integers(name: str, values: Array) -> NDArray[np.int64]:
    largest = float(np.abs(values).max())
    if largest > LARGEST:
        raise InputError(WHERE, name, f"{largest:.3g} of its units are more than int32 holds; use the source in float")
    return np.rint(values).astype(np.int64)


def _factor(value: float) -> str:
    """A real factor as a mantissa of 30 bits and a shift."""
    if value == 0.0:
        return "{0, 1}"
    shift = min(FACTOR_BITS - 1 - math.floor(math.log2(abs(value))), MAX_SHIFT)
    if shift < 1:
        raise InputError(WHERE, "int32", f"a factor of {value:.3g} is more than int32 holds; use the source in float")
    return f"{{{round(value * 2.0**shift)}, {shift}}}"


def _units(value: float, per_si: float) -> int:
    return int(_integers("int32", np.array([value * per_si]))[0])
