"""C99 source of the tuning: lookups, current references, current control, compensation. Decides no value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from orchestrator.analysis import COPPER_PER_K
from orchestrator.extras import require
from orchestrator.flux_maps import ROOM_C, in_ascii
from orchestrator.numerics.types import Array
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.current_control import CurrentControl, loop_gains
from orchestrator.tuning.limits import VOLTAGE_RESERVE, DriveLimits
from orchestrator.tuning.references import CurrentReferences
from protocols import InputError, Motor

WHERE = "C code"
NUMBERS_PER_LINE = 8
SPACING_TOLERANCE = 1e-6
"""Largest deviation of an axis from even spacing, in steps, and of a loss from an odd function, in parts of it."""
MIN_CURRENT_STEP_A = 1e-3
"""Between nodes of the flux: a thousand of the units in which the source in int32 counts."""


@dataclass(frozen=True)
class Table:
    """An array of the source: the axes' names and nodes in the order of its dimensions."""

    meaning: str
    axes: Mapping[str, Array]
    values: Array


def source_values(
    symbol: str,
    motor: Motor,
    references: CurrentReferences,
    control: CurrentControl,
    compensation: Compensation,
    limits: DriveLimits,
    magnet_per_k: float | None = None,
    basis: Sequence[str] = (),
) -> dict[str, Any]:
    """What the source's templates are filled with, in float and in int32.

    Parameters
    ----------
    symbol : str
        Prefix of all public names, a C identifier.
    motor : Motor
        For its name, pole pairs and magnet.
    magnet_per_k : float, optional
        Relative change of the magnet's flux [1/K]; without, the magnet's temperature is no argument.
    basis : sequence of str
        What the figures rest on, a sentence each, for the header's comment.

    Raises
    ------
    InputError
        Where a number is not finite, an axis is not evenly spaced, or the losses are not odd functions of the current.
    """
    winding_c = ROOM_C if control.winding_c is None else control.winding_c
    gain, observer = loop_gains(control.bandwidth_rad_s, control.integral_rad_s, control.period_s)
    scalars = {
        "pole_pairs": motor.pole_pairs,
        "r_s_ohm": control.r_s_ohm,
        "r_s_at_c": winding_c,
        "r_s_per_k": 1.0 / (1.0 / COPPER_PER_K + winding_c - 20.0),
        "current_a": limits.current_a,
        "period_s": control.period_s,
        "delay_s": control.delay_s,
        "current_delay_s": compensation.current_delay_s,
        "bandwidth_rad_s": control.bandwidth_rad_s,
        "integral_rad_s": control.integral_rad_s,
        "gain_rad_s": gain,
        "observer_rad_s": observer,
        "voltage_reserve": VOLTAGE_RESERVE,
        "angle_rad": compensation.angle_rad,
        "magnet_wb_per_k": (motor.pm_flux_wb or 0.0) * (magnet_per_k or 0.0),
    }
    vectors = {
        "gain": compensation.current_gain,
        "offset": compensation.current_offset_a,
        "bias": compensation.bias_ab_v,
    }
    for name, value in (scalars | vectors).items():
        _require_finite(name, np.asarray(value, dtype=np.float64))
    return {
        **scalars,
        **vectors,
        "winding_is_assumed": control.winding_c is None,
        "p": symbol,
        "P": symbol.upper(),
        "name": _comment(motor.name),
        "sources": _comment(", ".join(compensation.sources)),
        "left_out": [_comment(f"{left.name}: {left.reason}") for left in compensation.left_out],
        "ends_wb": f"{references.psi_limit_wb[0]:.4g}",
        "basis": [_comment(in_ascii(line)) for line in basis],
        "tables": _tables(references, control, compensation),
    }


def c_files(values: Mapping[str, Any]) -> dict[str, bytes]:
    """Header and source in float, by file name: `<symbol>_drive.h` and `<symbol>_drive.c`; from `source_values`."""
    filters: dict[str, Callable[..., Any]] = {"c": _float, "rows": lambda table: rows_of(map(_float, table.flat))}
    return {f"{values['p']}_drive.{kind}": rendered(f"drive.{kind}.j2", values, filters) for kind in ("h", "c")}


def _tables(references: CurrentReferences, control: CurrentControl, compensation: Compensation) -> dict[str, Table]:
    flux = {"PSI_D": control.i_d_a, "PSI_Q": control.i_q_a}
    inductance = {"L_D": control.gain_i_d_a, "L_Q": control.gain_i_q_a}
    limit = {"LIMIT": references.psi_limit_wb}
    phase, lost, per_bus = _positive_half(compensation)
    tables = {
        "psi_table": Table("psi_d, psi_q [Wb] over i_d and i_q [A]", flux, control.psi_wb),
        "inductance_table": Table("L_dd, L_dq, L_qq [H] over i_d and i_q [A]", inductance, control.inductance_h),
        "torque_limit_table": Table("largest torque [Nm] over flux limit [Wb]", limit, references.torque_limit_nm),
        "reference_table": Table(
            "least i_d, i_q [A] over flux limit [Wb] and share of the largest torque",
            limit | {"SHARE": references.share},
            references.i_dq_a,
        ),
        "lost_table": Table(
            "voltage lost in a leg [V] and its part per volt of the bus [1] over |i| [A]",
            {"PHASE": phase},
            np.stack([lost, per_bus], axis=-1),
        ),
    }
    for name, table in tables.items():
        _require_finite(name, table.values)
        for axis, nodes in table.axes.items():
            _require_even(axis.lower(), nodes)
    for axis, nodes in flux.items():
        if nodes[1] - nodes[0] < MIN_CURRENT_STEP_A:
            text = f"expected steps of {MIN_CURRENT_STEP_A:g} A or more, not {nodes[1] - nodes[0]:.3g} A"
            raise InputError(WHERE, axis.lower(), text)
    return tables


def _positive_half(compensation: Compensation) -> tuple[Array, Array, Array]:
    """The losses at currents from zero on: they are odd functions, and the source has half a table."""
    current = np.asarray(compensation.current_a, dtype=np.float64)
    _require_even("current_a", current)
    halves = [current]
    for name, table in (("lost_v", compensation.lost_v), ("lost_per_bus_v", compensation.lost_per_bus_v)):
        _require_finite(name, table)
        even = np.abs(table + table[::-1]).max()
        if even > SPACING_TOLERANCE * np.abs(table).max() or abs(current[0] + current[-1]) > 1e-6 * current[-1]:
            raise InputError(WHERE, name, f"expected an odd function of the current; its even part reaches {even:g}")
        halves.append(0.5 * (table - table[::-1]))
    start = len(current) // 2
    if len(current) % 2 == 0:
        raise InputError(
            WHERE, "current_a", f"expected an odd number of currents with zero amid them, not {len(current)}"
        )
    return current[start:] - current[start], halves[1][start:], halves[2][start:]


def _require_finite(name: str, values: Array) -> None:
    holes = int((~np.isfinite(values)).sum())
    if holes:
        raise InputError(WHERE, name, f"{holes} of {values.size} numbers are not finite; a drive needs all of them")


def _require_even(name: str, nodes: Array) -> None:
    _require_finite(name, nodes)
    if len(nodes) < 2 or not nodes[-1] > nodes[0]:
        raise InputError(WHERE, name, "expected two or more increasing nodes")
    even = np.linspace(nodes[0], nodes[-1], len(nodes))
    if np.abs(nodes - even).max() > SPACING_TOLERANCE * (even[1] - even[0]):
        raise InputError(WHERE, name, "expected evenly spaced nodes")


def rendered(template: str, values: Mapping[str, Any], filters: Mapping[str, Callable[..., Any]]) -> bytes:
    """A template of this room, filled."""
    require("report", "C code")
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters.update(filters)
    text = files("orchestrator.tuning").joinpath(template).read_text(encoding="ascii")
    return environment.from_string(text).render(values).encode("ascii")


def rows_of(literals: Iterable[str]) -> str:
    """The lines of an array's initialiser."""
    numbers = list(literals)
    lines = (numbers[k : k + NUMBERS_PER_LINE] for k in range(0, len(numbers), NUMBERS_PER_LINE))
    return ",\n".join("    " + ", ".join(line) for line in lines)


def _float(value: float) -> str:
    """The shortest literal of the same float."""
    return f"{np.float32(value)!s}f"


def _comment(text: str) -> str:
    """Text that does not end the comment, in ASCII and on one line."""
    line = " ".join(text.encode("ascii", "replace").decode().split())
    return line.replace("*/", "* /").replace("/*", "/ *")
