"""Validation of a fleet's table from any source: its columns have the types of `FleetRow`, or it is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from protocols import InputError
from protocols.fleet import arrow_schema

if TYPE_CHECKING:
    import pyarrow as pa

_MARKS = ("source", "serial", "R_s_ohm", "effects", "failed")
"""Columns by which a fleet's table is known; others that are missing are null."""
MAKES_A_TABLE = "; expected what `fluxbench fleet run RECORDINGS --out TABLE` writes"
"""End of the line about a path that is no fleet's table."""


def validate_types(table: pa.Table, place: str) -> pa.Table:
    """The table's columns in the types of `FleetRow`, whatever reader or writer they came through.

    Raises
    ------
    InputError
        Where a column is missing, is present twice, or has another type.
    """
    import pyarrow as pa

    names = table.column_names
    missing = [name for name in _MARKS if name not in names]
    if missing:
        raise InputError(place, missing[0], f"no such column: not a fleet's table{MAKES_A_TABLE}")
    schema = arrow_schema()
    columns = [
        _as(field, table.column(field.name), place)
        if names.count(field.name) == 1
        else _none(field, names.count(field.name), table.num_rows, place)
        for field in schema
    ]
    return pa.table(columns, names=schema.names)


def _none(field: pa.Field, count: int, rows: int, place: str) -> pa.Array:
    import pyarrow as pa

    if count:
        raise InputError(place, field.name, f"{count} columns have this name")
    return pa.nulls(rows, field.type)


def _as(field: pa.Field, column: Any, place: str) -> Any:
    """A column in the field's type; numbers become neither texts nor booleans, nor the other way round."""
    import pyarrow as pa

    problem = f"expected {field.type}, got {column.type}"[:160]
    if not pa.types.is_null(column.type) and _kind(column.type) != _kind(field.type):
        raise InputError(place, field.name, problem)
    try:
        values = column.cast(field.type)
        values.validate(full=True)
        if pa.types.is_timestamp(field.type):
            values.to_pylist()  # raises for years outside the calendar
    except (pa.ArrowException, ValueError, OverflowError, TypeError):
        raise InputError(place, field.name, problem) from None
    if field.name == "source" and values.null_count:
        raise InputError(place, field.name, f"{values.null_count} rows have none")
    _require_named(field, values, place)
    return values


def _require_named(field: pa.Field, column: Any, place: str) -> None:
    """Raise `InputError` where an item of a list lacks its name or unit."""
    import pyarrow as pa

    if not pa.types.is_list(field.type) or not pa.types.is_struct(field.type.value_type):
        return
    items = column.combine_chunks().flatten()
    for part in field.type.value_type:
        if pa.types.is_string(part.type) and items.field(part.name).null_count:
            raise InputError(place, f"{field.name}.{part.name}", "is null")


def _kind(kind: pa.DataType) -> str:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        return _kind(kind.value_type)
    if pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind):
        return "text"
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        return "number"
    if pa.types.is_list(kind) or pa.types.is_large_list(kind):
        return "list"
    return "time" if pa.types.is_timestamp(kind) else str(kind)
