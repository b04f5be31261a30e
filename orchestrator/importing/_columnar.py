"""CSV and Parquet as blocks of columns, streamed by pyarrow."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._mapping import CsvLayout
from orchestrator.importing._source import (
    BLOCK_ROWS,
    Block,
    Labels,
    Source,
    Wanted,
    as_labels,
    as_numbers,
    guarded,
    require_columns,
    unreadable,
)
from orchestrator.importing._stamps import dates_as_seconds
from protocols import InputError

_END_BYTES = 1 << 16
"""Bytes of either end of a text file that are read to explain an error."""


def open_csv(path: Path, wanted: Wanted, layout: CsvLayout) -> Source:
    """A text file of columns. Empty fields, NA and NaN are missing samples."""
    return Source(guarded(path, "CSV", lambda: _csv_blocks(path, wanted, layout)))


def open_parquet(path: Path, wanted: Wanted) -> Source:
    """A Parquet file. Nulls are missing samples."""
    return Source(guarded(path, "Parquet", lambda: _parquet_blocks(path, wanted)))


def _csv_blocks(path: Path, wanted: Wanted, layout: CsvLayout) -> Iterator[Block]:
    import pyarrow as pa
    from pyarrow import csv

    # With more than one thread, pyarrow omits the row number from its errors.
    read = csv.ReadOptions(
        use_threads=False,
        block_size=1 << 20,  # bytes; some of these are read ahead
        skip_rows=layout.skip_rows,
        skip_rows_after_names=layout.skip_rows_after_names,
        column_names=layout.names,
        encoding={"utf-8": "utf8", "latin-1": "latin1", "utf-16": "utf16"}[layout.encoding],
    )
    parse = csv.ParseOptions(delimiter=layout.delimiter)
    try:
        with csv.open_csv(path, read_options=read, parse_options=parse) as reader:
            names = list(reader.schema.names)
    except pa.ArrowInvalid as error:
        raise _csv_error(path, layout, [], str(error)) from None
    _require_once(path, wanted, names)
    types = {name: pa.string() if name in (wanted.label, wanted.dates) else pa.float64() for name in wanted.all}
    convert = csv.ConvertOptions(
        decimal_point=layout.decimal, column_types=types, include_columns=list(wanted.all), strings_can_be_null=False
    )
    try:
        with csv.open_csv(path, read_options=read, parse_options=parse, convert_options=convert) as reader:
            for batch in reader:
                yield _block(path, wanted, batch)
    except pa.ArrowInvalid as error:
        raise _csv_error(path, layout, names, str(error)) from None


def _csv_error(path: Path, layout: CsvLayout, names: list[str], message: str) -> InputError:
    torn = re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+)", message)
    if torn is not None:
        return InputError(str(path), "", _torn_row(path, layout, *map(int, torn.groups())))
    found = re.search(r"CSV column #(\d+): (Row #\d+)?.*invalid value '(.*)'", message, re.DOTALL)
    if found is None or int(found[1]) >= len(names):
        return unreadable(path, "CSV", ValueError(message))
    name, row = names[int(found[1])], (found[2] or "").lower()
    line = f"line {row.removeprefix('row #')}: " if row else ""
    return InputError(str(path), name, f"{line}expected a number, got {found[3][:40]!r}")


def _torn_row(path: Path, layout: CsvLayout, row: int, expected: int, got: int) -> str:
    """Why a line has another number of columns than the names: another layout, or a log that was cut off."""
    lines = _lines_at_both_ends(path, layout)
    if lines and layout.delimiter != ";" and ";" in lines[0]:
        decimal = next((line for line in lines[1:] if re.search(r"\d,\d", line)), None)
        written = "{delimiter: ';'}" if decimal is None else "{delimiter: ';', decimal: ','}"
        between = "';' between the columns" + ("" if decimal is None else " and decimal commas")
        return f"the file looks like one with {between}: state csv: {written} in the mapping"
    counted = f"line {row} has {got} columns, but the names are {expected}"
    if got < expected and len(lines) > 1 and lines[-1].count(layout.delimiter) == got - 1:
        return f"the last line is cut off: {counted}; delete it"
    return f"{counted}; mend or delete it"


def _lines_at_both_ends(path: Path, layout: CsvLayout) -> list[str]:
    """The first lines after the skipped ones and the last line, as far as `_END_BYTES` reach."""
    with path.open("rb") as file:
        first = file.read(_END_BYTES)
        file.seek(max(0, path.stat().st_size - _END_BYTES))
        last = file.read()
    start = first.decode(layout.encoding, errors="replace").splitlines()[layout.skip_rows :]
    return [*start[:5], *last.decode(layout.encoding, errors="replace").splitlines()[-1:]]


def _parquet_blocks(path: Path, wanted: Wanted) -> Iterator[Block]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        _require_once(path, wanted, list(file.schema_arrow.names))
        for batch in file.iter_batches(BLOCK_ROWS, columns=list(wanted.all), use_threads=False):
            yield _block(path, wanted, batch)


def _require_once(path: Path, wanted: Wanted, names: list[str]) -> None:
    require_columns(path, wanted.all, names)
    for name in wanted.all:
        if names.count(name) > 1:
            raise InputError(str(path), name, f"{names.count(name)} columns have this name")


def _block(path: Path, wanted: Wanted, batch: Any) -> Block:
    numbers = {
        name: as_numbers(path, name, batch.column(name).to_numpy(zero_copy_only=False)) for name in wanted.numbers
    }
    if wanted.dates is not None:
        numbers[wanted.dates] = dates_as_seconds(path, wanted.dates, batch.column(wanted.dates))
    return Block(numbers, None if wanted.label is None else _labels(batch.column(wanted.label)))


def _labels(column: Any) -> Labels:
    import pyarrow as pa

    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        if pa.types.is_dictionary(column.type):
            return _labels(column.dictionary_decode())
        return as_labels(column.to_numpy(zero_copy_only=False))
    encoded = column.fill_null("").dictionary_encode()
    return Labels(encoded.indices.to_numpy().astype(np.intp), tuple(encoded.dictionary.to_pylist()))
