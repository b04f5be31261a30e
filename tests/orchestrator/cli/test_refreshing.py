"""A run's report is as new as its results."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from orchestrator.cli._refreshing import refresh_report
from tests.support.processes import called

DATA = Path(__file__).parents[2] / "data" / "pm400-reduced"


@pytest.mark.slow
def test_estimating_again_writes_the_report_anew_where_there_is_one(tmp_path: Path) -> None:
    recording = Path(shutil.copytree(DATA, tmp_path / "recording"))
    page = recording / "report.html"
    page.write_text("of old")
    assert called("estimate", recording, "--estimator", "resistance", "--out", tmp_path / "elsewhere").returncode == 0
    assert page.read_text() == "of old"
    assert called("estimate", recording, "--estimator", "resistance").returncode == 0
    assert page.read_text().startswith("<!DOCTYPE html>")


def test_a_page_that_cannot_be_written_is_said_and_fails_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "report.html").write_text("of old")
    monkeypatch.setattr("orchestrator.cli._refreshing.REPORT", "nobodys")
    refresh_report(tmp_path, None)
    assert "report.html is older than these results: " in capsys.readouterr().err
