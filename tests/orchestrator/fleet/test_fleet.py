"""Sources in, rows out: each recording once, and what is wrong with one is its own row's alone."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from orchestrator.fleet import FleetJob, FleetTable, JobReport, Plan, find_sources, read_table
from protocols.fleet import FleetRow
from tests.orchestrator.fleet.small import damage, small_recordings
from tests.orchestrator.importing.benches import Bench, held_current, phase_log, write_table


def done(folder: Path, table: Path, plan: Plan | None = None, **how: Any) -> tuple[list[FleetRow], JobReport]:
    found = find_sources([str(folder)], files=plan is not None and plan.mapping is not None, limit=None, tell=_silent)
    with FleetTable.opened(table, **how) as held:
        job = FleetJob(found, held, plan or Plan())
        rows = list(job.rows())
    return rows, job.report(table, 0.0)


def _silent(_: str) -> None:
    pass


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[FleetRow], JobReport]:
    """Four recordings, one of them damaged, and a copy of one."""
    folder = tmp_path_factory.mktemp("fleet")
    made = small_recordings(folder / "bench" / "lot-7", 4)
    damage(made[2])
    shutil.copytree(made[0], folder / "bench" / "copy")
    return folder, *done(folder / "bench", folder / "table")


def test_each_recording_has_a_row(worked: tuple[Path, list[FleetRow], JobReport]) -> None:
    folder, rows, _ = worked
    assert read_table(folder / "table") == rows
    good = [row for row in rows if row.failed is None]
    assert {row.name for row in good} == {"motor-0", "motor-1", "motor-3"}
    for row in good:
        assert row.R_s_ohm is not None
        assert row.R_s_low_ohm is not None
        assert row.R_s_low_ohm < row.R_s_ohm == pytest.approx(4.31, abs=0.01)
        assert row.recorded_samples == 8000
        assert row.seconds > 0.0
        assert row.peak_mb > 10.0
        assert row.L_d_h is None


def test_a_bad_recording_is_a_row_that_names_the_file(worked: tuple[Path, list[FleetRow], JobReport]) -> None:
    _, rows, report = worked
    (bad,) = [row for row in rows if row.failed is not None]
    assert bad.name == "motor-2"
    assert bad.failed is not None
    assert "resistance-000.parquet: sha256" in bad.failed
    assert [failed.source for failed in report.failed] == [bad.source]


def test_a_copy_is_not_done_again(worked: tuple[Path, list[FleetRow], JobReport]) -> None:
    _, rows, report = worked
    assert (report.sources, report.new, report.same, report.known) == (5, 4, 1, 0)
    assert len({row.key for row in rows}) == len({row.content_sha256 for row in rows}) == 4


def test_a_job_that_is_started_again_does_what_is_new(worked: tuple[Path, list[FleetRow], JobReport]) -> None:
    folder, _, _ = worked
    small_recordings(folder / "bench" / "lot-8", 5)[4].rename(folder / "bench" / "late")
    shutil.rmtree(folder / "bench" / "lot-8")
    rows, report = done(folder / "bench", folder / "table")
    assert [row.name for row in rows] == ["motor-4"]
    assert (report.new, report.known, report.same) == (1, 4, 1)


def test_another_question_is_another_row_and_what_was_found_before_a_step_fails_stays(tmp_path: Path) -> None:
    small_recordings(tmp_path / "bench", 1)
    for steps in (("estimate",), ("estimate", "compare")):
        (row,), _ = done(tmp_path / "bench", tmp_path / "table", Plan(steps=steps))
    assert len(read_table(tmp_path / "table")) == 2
    assert row.R_s_ohm is not None
    assert row.failed is not None
    assert "too few to name a cause" in row.failed


def test_what_failed_is_tried_again_on_request_alone(tmp_path: Path) -> None:
    (path,) = small_recordings(tmp_path / "bench", 1)
    whole = (path / "recording.json").read_text()
    (path / "recording.json").write_text("{")
    assert done(tmp_path / "bench", tmp_path / "table")[1].failed
    assert done(tmp_path / "bench", tmp_path / "table")[1].new == 0
    assert done(tmp_path / "bench", tmp_path / "table", forget_failed=True)[1].new == 1
    (path / "recording.json").write_text(whole)
    rows, _ = done(tmp_path / "bench", tmp_path / "table", forget_failed=True)
    assert [row.failed for row in read_table(tmp_path / "table")] == [row.failed for row in rows] == [None]


def test_measurement_files_are_imported_first(tmp_path: Path) -> None:
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "scope.csv").write_text("time,current\n0,1\n")
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text("format: something else\n")
    plan = Plan(steps=("import", "estimate"), mapping=mapping)
    (row,), _ = done(tmp_path / "bench", tmp_path / "table", plan)
    assert row.asked[:2] == ("import", "estimate")
    assert row.failed is not None
    assert "mapping.yaml" in row.failed


def bench_below(folder: Path) -> Bench:
    """A held current as a text file with its mapping."""
    folder.mkdir()
    bench = Bench(folder, *phase_log(*held_current()))
    write_table(folder / "log.csv", bench.columns)
    bench.write_mapping()
    return bench


def test_a_mapping_that_was_mended_is_another_question(tmp_path: Path) -> None:
    """And a file's own name is what its row is called by: the mapping calls all alike."""
    bench = bench_below(tmp_path / "bench")
    plan = Plan(steps=("import", "estimate"), mapping=bench.folder / "mapping.yaml")
    bench.mapping["time"]["column"] = "nowhere"
    bench.write_mapping()
    _, report = done(bench.folder, tmp_path / "table", plan)
    assert (report.new, len(report.failed)) == (1, 1)
    _, again = done(bench.folder, tmp_path / "table", plan)
    assert (again.known, again.known_failed, again.new) == (1, 1, 0)
    bench.mapping["time"]["column"] = "t"
    bench.write_mapping()
    (row,), _ = done(bench.folder, tmp_path / "table", plan)
    assert (row.name, row.failed) == ("log", None)
    assert row.R_s_ohm is not None


def test_what_fails_after_an_import_names_the_file_that_was_imported(tmp_path: Path) -> None:
    bench = bench_below(tmp_path / "bench")
    mapping = bench.folder / "mapping.yaml"
    plan = Plan(steps=("import", "export"), mapping=mapping, keep=tmp_path / "kept")
    (row,), _ = done(bench.folder, tmp_path / "table", plan)
    assert row.failed == f"{bench.folder}/log.csv: has no map to export"
