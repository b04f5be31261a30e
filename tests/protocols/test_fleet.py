"""A row of a fleet's table: its schema is that of the model, and what goes in comes out."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import pyarrow as pa
import pyarrow.parquet as pq

from protocols.fleet import FleetEffect, FleetRow, FleetSetPoint, FleetVersions, HiddenEffect, arrow_schema

ROW = FleetRow(
    key="00",
    source="s3://bench/one",
    started_at=datetime(2026, 11, 24, 3, 0, tzinfo=UTC),
    recorded_samples=470_000,
    asked=("estimate", "diagnose"),
    R_s_ohm=4.25,
    set_points=(FleetSetPoint(i_d_a=0.0, i_q_a=1.0, psi_d_wb=0.3, psi_q_wb=0.07),),
    effects=(FleetEffect(name="dead_time", parameter="voltage_v", size=1.5, unit="V", low=1.4, high=None),),
    usable=True,
    versions=FleetVersions(fluxbench="0.1.0", python="3.11.7", numpy="2.3.0"),
    hidden=(HiddenEffect(name="dead_time", parameter="voltage_v", size=1.6),),
)


def test_columns_are_the_fields() -> None:
    schema = arrow_schema()
    assert schema.names == list(FleetRow.model_fields)
    assert schema.field("started_at").type == pa.timestamp("us", tz="UTC")
    assert schema.field("R_s_ohm").type == pa.float64()
    assert pa.types.is_struct(schema.field("effects").type.value_type)
    assert not schema.field("key").nullable


def test_a_row_comes_out_of_parquet_as_it_went_in() -> None:
    file = io.BytesIO()
    bare = FleetRow(key="01", source="runs/x", failed="recording.json: missing")
    pq.write_table(pa.Table.from_pylist([ROW.model_dump(), bare.model_dump()], schema=arrow_schema()), file)
    read = pq.read_table(file).to_pylist()
    assert [FleetRow.model_validate(row) for row in read] == [ROW, bare]
    assert read[1]["set_points"] is None
