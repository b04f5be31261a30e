"""The fleet's page shows what its JSON holds, to people who did not make it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from orchestrator.fleet.statistics import fleet_of, report_of
from plugins.streams.report._fleet_page import render, write_fleet_report
from protocols import StorageError
from protocols.fleet_report import FleetLimits, FleetReport
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, effect, table_of, written
from tests.support.processes import called


def imbalanced(row: dict[str, Any]) -> None:
    row["serial"] = "<b>0007</b>\x1b"
    row["effects"] = (effect("phase_resistance_imbalance", "extra_b_ohm", 0.090, 0.004, "ohm"),)


@pytest.fixture(scope="module")
def report() -> FleetReport:
    limits = FleetLimits.model_validate({"quantities": {"R_s_ohm": {"low": 4.20, "high": 4.40}}})
    table = fleet_of(table_of(Fleet(60, changes={7: imbalanced}).rows()), "/tables/line 3")
    return report_of(table, limits=limits)


def test_the_page_shows_outliers_limits_distributions_and_pictures(report: FleetReport) -> None:
    page = render(report, most_pictures=1)
    assert report.judgement is not None
    for text in (
        "<h1>line 3</h1>",
        "60 recordings of 60 motors from 2026-03-02 08:00 to 2026-03-04 19:00 UTC",
        f"{report.judgement.passed} of 60 pass",
        "phase resistance imbalance: extra b +",
        "Cpk",
        "R_s at 20 °C",
    ):
        assert text in page, text
    assert page.count("<img src=") == 2  # distances, and the one quantity
    assert "<script" not in page


def test_what_comes_from_outside_is_shown_and_not_obeyed(report: FleetReport) -> None:
    page = render(report, most_pictures=0)
    assert "&lt;b&gt;0007&lt;/b&gt;\\u001b" in page
    assert "<b>0007" not in page
    assert "\x1b" not in page


def test_long_tables_are_cut_and_say_so(report: FleetReport) -> None:
    page = render(report, most_pictures=0, most_rows=3)
    assert report.judgement is not None
    assert f"{len(report.judgement.others) - 3} more rows are in the JSON beside this page." in page
    assert f"{len(report.quantities) - 3} more rows are in the JSON beside this page." in page


def test_the_json_beside_the_page_is_the_report(report: FleetReport, tmp_path: Path) -> None:
    quick = report.model_copy(update={"quantities": report.quantities[:1]})
    page, data = write_fleet_report(quick, tmp_path)
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert FleetReport.model_validate_json(data.read_bytes()) == quick


def test_the_command_writes_both_into_the_tables_folder_and_says_what_it_found(tmp_path: Path) -> None:
    table = written(Fleet(12).rows(), tmp_path / "fleet.parquet")
    done = called("fleet", "report", table, "--against", table, "--limits", limits_file(tmp_path, "R_s_ohm: {low: 9}"))
    assert done.returncode == 0, done.stderr
    assert "0 of 12 pass; 12 fail" in done.stdout
    assert done.stdout.splitlines()[-2:] == [f"{tmp_path}/fleet-report.html", f"{tmp_path}/fleet-report.json"]
    document = json.loads((tmp_path / "fleet-report.json").read_text())
    assert document["pairs"]["count"] == 12
    assert document["pairs"]["changes"] == []


@pytest.mark.slow
def test_a_table_in_a_folder_is_a_table_still_beside_its_report(tmp_path: Path) -> None:
    (tmp_path / "table").mkdir()
    written(Fleet(12).rows(), tmp_path / "table" / "part-000000.parquet")
    done = called("fleet", "report", tmp_path / "table")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "table" / "_report" / "fleet-report.html").is_file()
    assert len(pd.read_parquet(tmp_path / "table")) == 12


def test_the_viewers_file_has_the_tables_and_each_course(report: FleetReport, tmp_path: Path) -> None:
    from plugins.streams.rerun import make_fleet_view
    from tests.plugins.streams.rerun.reading import entities, rows

    file = tmp_path / "fleet-report.rrd"
    for _ in range(2):  # made again, it is not made twice
        make_fleet_view(report, file)
    found = entities(file)
    charts = [one for one in report.quantities if one.chart is not None and one.of_motor]
    assert [found[f"/course/{k}"] for k in range(len(charts))] == [60] * len(charts)
    (remarks,) = [row for row in rows(file, "/fleet/remarks") if row.get("TextDocument:text")]
    assert report.remarks[0].text in remarks["TextDocument:text"][0]
    assert "/fleet/outliers" in found


def test_a_folder_that_is_not_there_is_made_and_one_that_cannot_be_is_stated(
    report: FleetReport, tmp_path: Path
) -> None:
    quick = report.model_copy(update={"quantities": ()})
    assert all(path.is_file() for path in write_fleet_report(quick, tmp_path / "a" / "b"))
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        write_fleet_report(quick, tmp_path / "file" / "below")


def test_what_is_wrong_is_one_line_and_exit_code_2(tmp_path: Path) -> None:
    table = written(Fleet(12).rows(), tmp_path / "fleet.parquet")
    unknown = limits_file(tmp_path, "R_x_ohm: {low: 9}")
    for words, message in (
        ((tmp_path / "none",), "no such table"),
        ((table, "--limits", unknown), f"{unknown}: quantities.R_x_ohm: unknown quantity; did you mean 'R_s_ohm'?"),
        ((table, "--against", "pairs"), "no serial number is measured twice"),
    ):
        done = called("fleet", "report", *words)
        assert done.returncode == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1


def limits_file(folder: Path, line: str) -> Path:
    path = folder / "limits.yaml"
    path.write_text(f"quantities:\n  {line}\n")
    return path
