"""Fleets made up from known distributions: the report gives back their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.fleet.statistics import FleetTable, fleet_of, read_fleet, report_of
from protocols import InputError
from protocols.fleet import FleetRow
from protocols.fleet_report import FleetReport
from tests.orchestrator.fleet.statistics.example_fleet import BEGAN, Fleet, effect, table_of, written


def table(fleet: Fleet) -> FleetTable:
    return fleet_of(table_of(fleet.rows()), "line")


def codes(report: FleetReport) -> list[str]:
    return [remark.code for remark in report.remarks]


def imbalanced(row: dict[str, Any]) -> None:
    row["effects"] = (effect("phase_resistance_imbalance", "extra_b_ohm", 0.090, 0.004, "ohm"),)


def bridged_turn(row: dict[str, Any]) -> None:
    """L_q within the fleet's range, and far from where this L_d has it."""
    row["L_d_h"], row["L_q_h"] = 0.0433 * 1.015, 0.0672 * 0.985


def with_dead_time(row: dict[str, Any]) -> None:
    row["effects"] = (*row["effects"], effect("dead_time", "voltage_v", 2.0, 0.2, "V"))


def unsharp(row: dict[str, Any]) -> None:
    row["effects"] = (effect("phase_resistance_imbalance", "extra_b_ohm", 0.090, 0.080, "ohm"),)


def test_a_uniform_fleet_raises_no_alarm() -> None:
    report = report_of(table(Fleet(150, seed=4)))
    assert codes(report) == ["no_outliers"]
    assert report.recordings == report.serials == 150
    middle = {one.name: one for one in report.quantities}
    assert middle["R_s_20_ohm"].middle == pytest.approx(4.25, rel=0.002)
    assert middle["R_s_20_ohm"].spread == pytest.approx(0.004 * 4.25, rel=0.35)
    assert middle["R_s_20_ohm"].typical_interval == pytest.approx(0.004, rel=0.05)
    assert [q.share for q in middle["L_d_h"].quantiles] == [0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99]
    assert middle["psi_q_wb(0, 2)"].unit == "Wb"
    assert sum(middle["L_q_h"].histogram.counts if middle["L_q_h"].histogram else ()) == 150


def test_outliers_are_named_by_the_serial_number_and_what_makes_them() -> None:
    report = report_of(table(Fleet(150, seed=4, changes={7: imbalanced, 60: bridged_turn, 90: with_dead_time})))
    outlying = {one.recording.serial: one for one in report.outliers}
    assert set(outlying) == {"0007", "0060", "0090"}
    assert outlying["0007"].text.startswith("serial 0007: phase resistance imbalance: extra b +")
    assert outlying["0007"].reasons[0].sigma == pytest.approx(7.0, abs=1.5)
    assert outlying["0007"].reasons[0].sure
    assert {reason.quantity for reason in outlying["0060"].reasons} == {"L_d_h", "L_q_h"}
    assert "unusual in combination with the others" in outlying["0060"].text
    assert outlying["0090"].text.endswith("dead time: voltage 2 V, in 1 recording only")
    assert outlying["0090"].distance is None
    for one in report.outliers[:1]:
        assert one.distance is not None
        assert one.limit is not None
        assert one.distance > one.limit


def test_a_value_whose_own_interval_contains_the_median_says_so() -> None:
    report = report_of(table(Fleet(150, seed=4, changes={7: unsharp})))
    assert [one.recording.serial for one in report.outliers] == ["0007"]
    assert report.outliers[0].text.endswith("but its own interval contains the median")


def test_a_third_of_the_fleet_that_is_another_motor_is_separated() -> None:
    def other(row: dict[str, Any]) -> None:
        row["R_s_ohm"] *= 1.2
        row["L_d_h"] *= 1.3
        row["L_q_h"] *= 1.3
        row["R_s_low_ohm"], row["R_s_high_ohm"] = row["R_s_ohm"] - 0.004, row["R_s_ohm"] + 0.004

    report = report_of(table(Fleet(120, seed=1, changes=dict.fromkeys(range(0, 120, 3), other))))
    outlying = {int(one.recording.serial or "") for one in report.outliers}
    assert set(range(0, 120, 3)) <= outlying
    assert len(outlying) <= 42


def test_few_recordings_are_looked_at_one_quantity_at_a_time() -> None:
    def shorted(row: dict[str, Any]) -> None:
        row["L_d_h"] *= 0.1

    report = report_of(table(Fleet(9, seed=2, changes={3: shorted})))
    assert report.distances is None
    assert "no_distance" in codes(report)
    assert [one.recording.serial for one in report.outliers] == ["0003"]


def test_a_drift_has_an_interval_and_the_chart_shows_its_beginning() -> None:
    report = report_of(table(Fleet(150, seed=5, drift_wb_per_day=-4e-4)))
    psi = next(one for one in report.quantities if one.name == "psi_pm_wb")
    assert psi.drift is not None
    assert psi.drift.low < -4e-4 < psi.drift.high < 0.0
    assert psi.drift.drifts
    assert [r.values["label"] for r in report.remarks if r.code == "drift"] == ["ψ_pm"]
    assert psi.chart is not None
    assert psi.chart.beyond > 20
    assert psi.chart.first_beyond is not None


def test_a_batch_that_is_off_is_named_with_by_how_much() -> None:
    report = report_of(table(Fleet(150, seed=6, batch_shift_h={1: 6e-4})))
    (batch,) = [b for one in report.quantities if one.name == "L_d_h" for b in one.batches if b.batch == "week 11"]
    assert batch.shifted
    assert batch.low < 6e-4 < batch.high
    assert batch.low > 0.0
    assert ("batch", "week 11") in [(r.code, r.values.get("batch")) for r in report.remarks]


def test_without_temperatures_the_resistance_itself_is_compared() -> None:
    def unknown(row: dict[str, Any]) -> None:
        row["temperature_c"] = None

    report = report_of(table(Fleet(60, changes={5: unknown})))
    assert report.distances is not None
    assert "R_s_ohm" in report.distances.quantities
    assert "R_s_20_ohm" not in {one.name for one in report.quantities}


def test_what_does_not_scatter_was_typed_in_and_is_neither_drawn_nor_compared() -> None:
    def of_the_nameplate(row: dict[str, Any]) -> None:
        row["psi_pm_wb"] = 0.3 * (1.0 + 1e-9 * int(row["serial"]))

    report = report_of(table(Fleet(60, changes=dict.fromkeys(range(60), of_the_nameplate))))
    (psi,) = [one for one in report.quantities if one.name == "psi_pm_wb"]
    assert (psi.histogram, psi.chart) == (None, None)
    assert report.distances is not None
    assert "psi_pm_wb" not in report.distances.quantities


def test_recordings_of_one_moment_have_no_course() -> None:
    def now(row: dict[str, Any]) -> None:
        row["started_at"] = BEGAN

    report = report_of(table(Fleet(20, changes=dict.fromkeys(range(20), now))))
    assert all(one.chart is None and one.drift is None for one in report.quantities)


def test_failed_recordings_are_counted_and_not_computed_with() -> None:
    rows = Fleet(20).rows()
    torn = FleetRow(key="x", source="/line/torn", failed="captures/0.parquet: not Parquet")
    report = report_of(fleet_of(table_of([*rows, torn]), "line"))
    assert report.recordings == 20
    assert [(one.what, one.count) for one in report.failures] == [("captures/0.parquet: not Parquet", 1)]
    assert report.remarks[0].text == "1 recording without results, most often: captures/0.parquet: not Parquet"


def test_of_a_recording_that_was_done_twice_the_fuller_row_counts() -> None:
    rows = Fleet(20).rows()
    bare = rows[3].model_copy(update={"key": "y", "verdict": None, "effects": None, "L_d_h": None})
    outlying = fleet_of(table_of([*rows, bare]), "line")
    assert len(outlying) == 20
    assert np.isfinite(outlying.columns["L_d_h"].values).all()


def test_the_report_is_the_same_read_back_from_its_json() -> None:
    report = report_of(table(Fleet(60, changes={7: imbalanced})))
    assert FleetReport.model_validate_json(report.model_dump_json()) == report


def test_a_folder_of_parquet_files_is_one_table(tmp_path: Path) -> None:
    rows = Fleet(30).rows()
    written(rows[:10], tmp_path / "part-0.parquet")
    written(rows[10:], tmp_path / "part-1.parquet")
    (tmp_path / "fleet-report.json").write_text("{}")
    assert [r.serial for r in read_fleet(str(tmp_path)).recordings] == [row.serial for row in rows]


def damaged_in(part: Path, offset: int) -> None:
    """Change bytes: of the footer, or of a page of data."""
    content = bytearray(part.read_bytes())
    content[offset : offset + 8 if offset >= 0 else None] = b"\xff" * (8 if offset >= 0 else -offset)
    part.write_bytes(content)


@pytest.mark.parametrize("offset", [-20, 60], ids=["footer", "data"])
def test_a_part_that_cannot_be_read_is_named_and_counted(tmp_path: Path, offset: int) -> None:
    rows = Fleet(90).rows()
    for k in range(3):
        written(rows[30 * k : 30 * k + 30], tmp_path / f"part-{k}.parquet")
    damaged_in(tmp_path / "part-1.parquet", offset)
    table = read_fleet(str(tmp_path))
    assert len(table) == 60
    (problem,) = table.damaged
    assert problem.startswith(f"{tmp_path / 'part-1.parquet'}: cannot be read as Parquet: ")
    report = report_of(table)
    assert report.damaged == (problem,)
    assert codes(report)[0] == "damaged"
    assert report.remarks[0].text.startswith("1 part of the table cannot be read, and their recordings are missing")


def test_where_no_part_can_be_read_there_is_no_report(tmp_path: Path) -> None:
    (tmp_path / "part-0.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_fleet(str(tmp_path))


def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    text = tmp_path / "notes.parquet"
    text.write_text("no Parquet")
    other = tmp_path / "other.parquet"
    pq.write_table(pa.table({"a": [1]}), other)
    for path, problem in (
        (text, "cannot be read as Parquet"),
        (other, "source: no such column"),
        (tmp_path / "x", "no such"),
    ):
        with pytest.raises(InputError, match=problem) as error:
            read_fleet(str(path))
        assert "\n" not in str(error.value)
    failed = FleetRow(key="x", source="s", failed="torn")
    with pytest.raises(InputError, match="no recording has results"):
        report_of(fleet_of(table_of([failed]), "line"))
