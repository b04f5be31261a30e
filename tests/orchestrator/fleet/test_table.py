"""The table: each row once, whatever ends the process that writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.dataset as ds
import pytest

from orchestrator.fleet import FleetTable, TableSettings, parts_of, read_table
from protocols import InputError
from protocols.fleet import FleetRow, FleetVersions

VERSIONS = FleetVersions(fluxbench="1", python="3", numpy="2")


def row(key: str, **fields: Any) -> dict[str, Any]:
    return FleetRow(key=key, source=f"runs/{key}", fingerprint="f", versions=VERSIONS, **fields).model_dump()


def test_rows_are_written_in_batches_and_the_rest_at_the_end(tmp_path: Path) -> None:
    with FleetTable.opened(tmp_path / "t", TableSettings(batch_rows=2, batch_s=1e9)) as table:
        for key in "abcde":
            table.add(row(key))
        assert len(parts_of(tmp_path / "t")) == 2
    assert [found.key for found in read_table(tmp_path / "t")] == list("abcde")
    assert ds.dataset(tmp_path / "t").count_rows() == 5
    assert list(pd.read_parquet(tmp_path / "t").key) == list("abcde")


def test_a_batch_is_written_when_it_has_waited_long_enough(tmp_path: Path) -> None:
    with FleetTable.opened(tmp_path / "t", TableSettings(batch_s=0.0)) as table:
        table.add(row("a"))
        assert len(parts_of(tmp_path / "t")) == 1


def test_a_table_that_is_opened_again_knows_its_rows(tmp_path: Path) -> None:
    for key in "ab":
        with FleetTable.opened(tmp_path / "t") as table:
            table.add(row(key, asked=("estimate",)))
    with FleetTable.opened(tmp_path / "t") as table:
        assert table.keys == {"a", "b"}
        assert table.visit("runs/a", "f", ("estimate",), "1") == "done"
        for other in (("runs/c", "f", ("estimate",), "1"), ("runs/a", "g", ("estimate",), "1"),
                      ("runs/a", "f", ("compare",), "1"), ("runs/a", "f", ("estimate",), "2")):  # fmt: skip
            assert table.visit(*other) is None
        with pytest.raises(ValueError, match="the table has this row already"):
            table.add(row("a"))


def test_what_a_kill_left_half_written_is_removed(tmp_path: Path) -> None:
    with FleetTable.opened(tmp_path / "t") as table:
        table.add(row("a"))
    (tmp_path / "t" / ".part-000001.parquet.partial").write_bytes(b"PAR1")
    with FleetTable.opened(tmp_path / "t") as table:
        assert table.keys == {"a"}
        assert not list((tmp_path / "t").glob(".*.partial"))


def test_what_failed_may_be_forgotten(tmp_path: Path) -> None:
    with FleetTable.opened(tmp_path / "t", TableSettings(batch_rows=2)) as table:
        for key, failed in (("a", None), ("b", "bad"), ("c", "bad")):
            table.add(row(key, failed=failed))
    with FleetTable.opened(tmp_path / "t", forget_failed=True) as table:
        assert table.keys == {"a"}
        table.add(row("b"))
    assert [found.key for found in read_table(tmp_path / "t")] == ["a", "b"]


def test_one_process_writes_a_table(tmp_path: Path) -> None:
    with (
        FleetTable.opened(tmp_path / "t"),
        pytest.raises(InputError, match="another fluxbench process"),
        FleetTable.opened(tmp_path / "t"),
    ):
        pass


def test_nothing_is_put_into_somebody_elses_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(InputError, match=r"thesis\.tex"), FleetTable.opened(tmp_path):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    (tmp_path / "part-000000.parquet").write_bytes(b"PAR1 and then nothing")
    with pytest.raises(InputError, match=r"part-000000\.parquet"), FleetTable.opened(tmp_path):
        pass
