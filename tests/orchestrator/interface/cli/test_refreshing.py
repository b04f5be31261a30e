"""A run's report is as new as its results."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from orchestrator.interface.cli._refreshing import refresh_report
from tests.support.processes import called

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"


@pytest.mark.slow
def test_estimating_again_writes_the_report_anew_where_there_is_one(tmp_path: Path) -> None:
    recording = Path(shutil.copytree(DATA, tmp_path / "recording"))
    page = recording / "report.html"
    page.write_text("of old")
    assert called("estimate", recording, "--estimator", "resistance", "--out", tmp_path / "elsewhere").returncode == 0
    assert page.read_text() == "of old"
    assert called("estimate", recording, "--estimator", "resistance").returncode == 0
    assert page.read_text() == "of old"  # results of one alone are elsewhere
    assert called("estimate", recording).returncode == 0
    assert page.read_text().startswith("<!DOCTYPE html>")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a page and a result, and no stream that could write the page: the attempt is reported."""
    monkeypatch.setattr("orchestrator.interface.cli._refreshing.REPORT", "nobodys")
    (tmp_path / "results").mkdir()
    for name in ("report.html", "results/estimates.json"):
        (tmp_path / name).write_text("of old")
        os.utime(tmp_path / name, (1e9, 1e9))
    return tmp_path


def test_a_page_that_cannot_be_written_is_stated_and_fails_nothing(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "results" / "estimates.json").write_text("new")
    refresh_report(run, None)
    assert "report.html is older than these results: " in capsys.readouterr().err


def test_a_page_as_new_as_all_that_it_is_made_from_is_left(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refresh_report(run, None)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("source", ["journal.jsonl", "model.json", "results/diagnosis.json"])
def test_a_newer_source_of_any_kind_has_the_page_written_again(
    source: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / source).write_text("new")
    refresh_report(run, None)
    assert "report.html is older" in capsys.readouterr().err
