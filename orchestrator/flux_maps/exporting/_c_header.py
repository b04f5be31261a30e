"""C headers of the lookup tables, with the lookups: in float, and in Q15 with scale factors. Decides no content."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orchestrator.flux_maps.exporting._c_tables import Axis, HeaderTables, Table, header_tables
from orchestrator.flux_maps.exporting._products import FileContent, Products

_SCALES = {"a": "CURRENT", "wb": "FLUX", "h": "INDUCTANCE", "nm": "TORQUE", "rad": "ANGLE"}

_FLOAT_LOOKUPS = """\
static inline float {p}_position(float x, float first, float per_unit, int count)
{{
    const float last = (float)(count - 1);
    const float position = (x - first) * per_unit;
    return position < 0.0f ? 0.0f : (position > last ? last : position);
}}

static inline float {p}_along(const float *table, int count, float position)
{{
    int k = (int)position;
    if (k > count - 2) k = count - 2;
    const float u = position - (float)k;
    return table[k] + u * (table[k + 1] - table[k]);
}}

static inline float {p}_over(const float *table, int rows, int columns, float row, float column)
{{
    int k = (int)row;
    if (k > rows - 2) k = rows - 2;
    const float u = row - (float)k;
    const float near_row = {p}_along(table + k * columns, columns, column);
    const float far_row = {p}_along(table + (k + 1) * columns, columns, column);
    return near_row + u * (far_row - near_row);
}}
"""

_Q15_LOOKUPS = """\
/* Positions are Q16 counts of steps. Right shifts of negative numbers must be arithmetic, as they commonly are. */
static inline int32_t {p}_position(int16_t x, int32_t first, int32_t per_lsb_q31, int32_t count)
{{
    const int64_t last = (int64_t)(count - 1) << 16;
    const int64_t position = (((int64_t)x - first) * per_lsb_q31) >> 15;
    return (int32_t)(position < 0 ? 0 : (position > last ? last : position));
}}

static inline int64_t {p}_along_q31(const int16_t *table, int32_t count, int32_t position)
{{
    int32_t k = position >> 16;
    if (k > count - 2) k = count - 2;
    const int64_t u = position - ((int64_t)k << 16);
    return (int64_t)table[k] * (65536 - u) + (int64_t)table[k + 1] * u;
}}

static inline int16_t {p}_along(const int16_t *table, int32_t count, int32_t position)
{{
    return (int16_t)(({p}_along_q31(table, count, position) + 32768) >> 16);
}}

static inline int16_t {p}_over(const int16_t *table, int32_t rows, int32_t columns, int32_t row, int32_t column)
{{
    int32_t k = row >> 16;
    if (k > rows - 2) k = rows - 2;
    const int64_t u = row - ((int64_t)k << 16);
    const int64_t near_row = {p}_along_q31(table + k * columns, columns, column);
    const int64_t far_row = {p}_along_q31(table + (k + 1) * columns, columns, column);
    return (int16_t)((near_row * (65536 - u) + far_row * u + ((int64_t)1 << 31)) >> 32);
}}
"""


@dataclass(frozen=True)
class _Style:
    """The differences between the float header and the fixed-point one."""

    kind: Literal["float", "q15"]
    prefix: str
    type: str
    scales: dict[str, float]
    """Full scale of each unit; empty in float."""

    def number(self, value: float, unit: str) -> str:
        if self.kind == "float":
            return _float(value)
        return str(int(np.clip(round(value / self.scales[unit] * 32768.0), -32768, 32767)))


def c_float_file(products: Products) -> FileContent:
    """`flux_map.h`: SI units in float."""
    return _written(products, header_tables(products), "float")


def c_q15_file(products: Products) -> FileContent:
    """`flux_map_q15.h`: 16-bit fixed point, value = table * scale / 32768."""
    return _written(products, header_tables(products), "q15")


def _written(products: Products, held: HeaderTables, kind: Literal["float", "q15"]) -> FileContent:
    if kind == "float":
        style = _Style("float", products.symbol, "float", {})
    else:
        style = _Style("q15", f"{products.symbol}_q15", "int16_t", _full_scales(held))
    filled = int((~held.measured).sum())
    note = f"{filled} of {held.measured.size} nodes lie outside the measured region and are continued; masks mark them"
    text = _render(products, held, style)
    share = 100.0 * float(held.measured.mean())
    return FileContent(text.encode("ascii"), share, filled_nodes=filled, notes=(*held.notes, note))


def _full_scales(held: HeaderTables) -> dict[str, float]:
    """Smallest full scale of each unit, rounded up to four digits, that holds all its tables and axes."""
    largest: dict[str, float] = {}
    for table in held.tables:
        largest[table.unit] = max(largest.get(table.unit, 0.0), float(np.abs(table.values).max()))
        for axis in table.axes:
            largest[axis.unit] = max(largest.get(axis.unit, 0.0), float(np.abs(axis.nodes).max()))
    scales = {unit: _round_up(value * 32768.0 / 32767.0) for unit, value in largest.items()}
    return scales | ({"rad": math.pi} if "rad" in scales else {})


def _round_up(value: float) -> float:
    if value == 0.0:
        return 1.0
    decade = 10.0 ** (math.floor(math.log10(value)) - 3)
    return math.ceil(value / decade) * decade


def _render(products: Products, held: HeaderTables, style: _Style) -> str:
    guard = f"{style.prefix.upper()}_FLUX_MAP_H"
    blocks = [
        _opening(products, held, style),
        f"#ifndef {guard}\n#define {guard}\n\n#include <stdint.h>\n",
        _constant_lines(products, style),
    ]
    if style.scales:
        blocks.append(_scale_lines(style))
    blocks += [_axis_lines(axis, style) for axis in held.axes]
    blocks += [_table_lines(table, style) for table in held.tables]
    for mask in held.masks:
        rows, columns = mask.values.shape
        body = _rows([[str(int(v)) for v in row] for row in mask.values])
        blocks.append(
            f"/* {mask.meaning}: 1 measured, 0 continued */\n"
            f"static const uint8_t {style.prefix}_{mask.name}[{rows}][{columns}] = {{\n{body}\n}};\n"
        )
    lookups = _FLOAT_LOOKUPS if style.kind == "float" else _Q15_LOOKUPS
    blocks.append("/* Linear lookups, held at the ends of the axes. */\n" + lookups.format(p=style.prefix))
    blocks += [_function_lines(table, style) for table in held.tables]
    blocks.append(f"#endif /* {guard} */\n")
    return "\n".join(blocks)


def _opening(products: Products, held: HeaderTables, style: _Style) -> str:
    units = "SI units" if style.kind == "float" else "Q15: value = entry * scale / 32768, scales below in SI units"
    lines = [
        f"Flux map of {products.motor.name} (method {products.flux_map.method}), written by fluxbench.",
        *([f"Recording: {products.recording}."] if products.recording else []),
        "",
        f"{units}; peak-valued dq vectors (amplitude-invariant), electrical angles.",
        "Row-major: entry [r][c] belongs to node r of the first axis and node c of the second; node k of an axis is",
        "first + k * step. Nodes outside the measured region are continued by least curvature (masks at the end).",
        "",
        *products.notes,
        *held.notes,
    ]
    # A name must not end the comment, and a header is ASCII.
    safe = [line.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *") for line in lines]
    return "/*\n" + "".join(f" * {line}".rstrip() + "\n" for line in safe) + " */"


def _constant_lines(products: Products, style: _Style) -> str:
    """Pole pairs, R_s where it is known, and the flux at zero current where that was measured; SI in both headers."""
    stem = style.prefix.upper()
    lines = [f"#define {stem}_POLE_PAIRS {products.motor.pole_pairs}"]
    if products.motor.stator_resistance_ohm is not None:
        lines.append(f"#define {stem}_R_S_OHM ({_float(products.motor.stator_resistance_ohm)})")
    if products.rest_wb is not None:
        lines.append(f"#define {stem}_PSI_M_WB ({_float(products.rest_wb)}) /* psi_d at zero current */")
    return "\n".join(lines) + "\n"


def _scale_lines(style: _Style) -> str:
    lines = [
        f"#define {style.prefix.upper()}_{_SCALES[unit]}_SCALE_{unit.upper()} ({_float(scale)})"
        for unit, scale in style.scales.items()
    ]
    return "/* Full scale: the value of 32768. */\n" + "\n".join(lines) + "\n"


def _axis_lines(axis: Axis, style: _Style) -> str:
    stem, unit = f"{style.prefix.upper()}_{axis.name.upper()}", axis.unit.upper()
    lines = [
        f"/* axis {axis.name}: {axis.nodes[0]:.9g} to {axis.nodes[-1]:.9g} {_unit(axis.unit)} */",
        f"#define {stem}_COUNT {len(axis.nodes)}",
        f"#define {stem}_FIRST_{unit} ({_float(axis.nodes[0])})",
        f"#define {stem}_STEP_{unit} ({_float(axis.step)})",
    ]
    if style.kind == "float":
        lines.append(f"#define {stem}_PER_{unit} ({_float(1.0 / axis.step)})")
    else:
        per_lsb = round(style.scales[axis.unit] / 32768.0 / axis.step * 2.0**31)
        lines.append(f"#define {stem}_FIRST_Q15 ({style.number(float(axis.nodes[0]), axis.unit)})")
        lines.append(f"#define {stem}_PER_LSB_Q31 ({per_lsb}) /* steps per least significant bit, times 2^31 */")
    return "\n".join(lines) + "\n"


def _table_lines(table: Table, style: _Style) -> str:
    shape = "".join(f"[{len(axis.nodes)}]" for axis in table.axes)
    over = " by ".join(f"{axis.name} [{_unit(axis.unit)}]" for axis in table.axes)
    if table.values.ndim == 1:
        body = "    " + ", ".join(style.number(float(v), table.unit) for v in table.values)
    else:
        body = _rows([[style.number(float(v), table.unit) for v in row] for row in table.values])
    return (
        f"/* {table.meaning} [{_unit(table.unit)}], {over} */\n"
        f"static const {style.type} {style.prefix}_{table.name}_table{shape} = {{\n{body}\n}};\n"
    )


def _function_lines(table: Table, style: _Style) -> str:
    stems = [f"{style.prefix.upper()}_{axis.name.upper()}" for axis in table.axes]
    if style.kind == "float":
        values = [f"{axis.name}_{axis.unit}" for axis in table.axes]
        ends = [(f"FIRST_{axis.unit.upper()}", f"PER_{axis.unit.upper()}") for axis in table.axes]
    else:
        values = [f"{axis.name}_q15" for axis in table.axes]
        ends = [("FIRST_Q15", "PER_LSB_Q31")] * len(table.axes)
    positions = ",\n        ".join(
        f"{style.prefix}_position({value}, {stem}_{first}, {stem}_{per}, {stem}_COUNT)"
        for value, stem, (first, per) in zip(values, stems, ends, strict=True)
    )
    array = f"{style.prefix}_{table.name}_table"
    reader, start = ("along", array) if len(stems) == 1 else ("over", f"&{array}[0][0]")
    counts = ", ".join(f"{stem}_COUNT" for stem in stems)
    return (
        f"/* {table.meaning} [{_unit(table.unit)}{'' if style.kind == 'float' else ', Q15'}] */\n"
        f"static inline {style.type} {style.prefix}_{table.name}("
        f"{', '.join(f'{style.type} {value}' for value in values)})\n{{\n"
        f"    return {style.prefix}_{reader}({start}, {counts},\n        {positions});\n}}\n"
    )


def _rows(rows: list[list[str]]) -> str:
    return ",\n".join("    {" + ", ".join(row) + "}" for row in rows)


def _float(value: float) -> str:
    text = f"{float(value):.9g}"
    return f"{text}f" if any(mark in text for mark in ".en") else f"{text}.0f"


def _unit(unit: str) -> str:
    return {"a": "A", "wb": "Wb", "h": "H", "nm": "Nm", "rad": "rad"}[unit]
