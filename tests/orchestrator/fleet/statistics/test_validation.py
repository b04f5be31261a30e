"""Tables that other programs made or changed: read, or refused in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from orchestrator.fleet.statistics import fleet_of, report_of
from protocols import InputError
from protocols.fleet import arrow_schema
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, table_of

OTHERS: dict[str, Any] = {
    "whole numbers": 1,
    "texts": "\x1b[2J",
    "booleans": True,
    "lists": [1.0],
    "structs": {"a": 1},
    "bytes": b"\xff",
}


@pytest.fixture(scope="module")
def table() -> pa.Table:
    return table_of(Fleet(12).rows())


def with_column(table: pa.Table, name: str, column: Any) -> pa.Table:
    return table.set_column(table.column_names.index(name), name, column)


def refusal_of(table: pa.Table) -> str:
    try:
        fleet_of(table, "table")
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("value", OTHERS.values(), ids=OTHERS)
def test_any_column_of_another_type_is_read_or_refused_in_one_line(table: pa.Table, value: Any) -> None:
    for name in arrow_schema().names:
        changed = with_column(table, name, pa.array([value] * table.num_rows))
        problem = refusal_of(changed)
        assert not problem or problem.startswith(f"table: {name}: expected ")
        assert "\n" not in problem


def test_what_is_missing_is_null_but_what_tells_a_fleet_s_table(table: pa.Table) -> None:
    for name in arrow_schema().names:
        if name in ("source", "serial", "R_s_ohm", "effects", "failed"):
            with pytest.raises(InputError, match=f"{name}: no such column: not a fleet's table"):
                fleet_of(table.drop_columns([name]), "table")
        else:
            assert len(fleet_of(table.drop_columns([name]), "table")) == 12


def test_a_column_that_is_there_twice_and_rows_without_a_source_are_refused(table: pa.Table) -> None:
    with pytest.raises(InputError, match="serial: 2 columns have this name"):
        fleet_of(table.append_column("serial", table.column("serial")), "table")
    with pytest.raises(InputError, match="source: 12 rows have none"):
        fleet_of(with_column(table, "source", pa.nulls(12, pa.string())), "table")


def test_a_table_without_rows_is_refused_and_so_is_one_where_all_failed(table: pa.Table) -> None:
    assert refusal_of(table.slice(0, 0)) == "table: holds no recording"
    failed = fleet_of(with_column(table, "failed", pa.array(["damaged"] * 12)), "table")
    assert (len(failed), len(failed.failures)) == (0, 12)
    with pytest.raises(InputError, match="no recording has results"):
        report_of(failed)


def test_texts_as_other_writers_keep_them_and_numbers_of_other_lengths_are_the_same(table: pa.Table) -> None:
    other = with_column(table, "serial", table.column("serial").cast(pa.large_string()).dictionary_encode())
    other = with_column(other, "R_s_ohm", table.column("R_s_ohm").cast(pa.float32()))
    original, read = fleet_of(table, "table"), fleet_of(other, "table")
    assert [one.serial for one in read.recordings] == [one.serial for one in original.recordings]
    np.testing.assert_allclose(read.columns["R_s_ohm"].values, original.columns["R_s_ohm"].values, rtol=1e-6)


def test_an_infinite_value_is_not_known(table: pa.Table) -> None:
    values = table.column("L_d_h").to_numpy().copy()
    values[3] = np.inf
    original = fleet_of(with_column(table, "L_d_h", pa.array(values)), "table").columns["L_d_h"]
    assert np.flatnonzero(~original.known).tolist() == [3]
