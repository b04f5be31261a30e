"""`fluxbench fleet report` and `priors` of a table of which a part is damaged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orchestrator.interface.cli._running import run_app
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, written

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """A table of three parts, one of which is cut."""
    table = tmp_path / "table"
    table.mkdir()
    rows = Fleet(30).rows()
    for k in range(3):
        written(rows[10 * k : 10 * k + 10], table / f"part-00000{k}.parquet")
    part = table / "part-000001.parquet"
    part.write_bytes(part.read_bytes()[:-100])
    return table


@pytest.mark.parametrize(
    "words", [["priors", "--out", "priors.json"], pytest.param(["report"], marks=pytest.mark.slow)], ids=lambda w: w[0]
)
def test_a_damaged_part_is_named_and_the_exit_code_is_3_unless_it_is_skipped(
    words: list[str], damaged: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(damaged.parent)
    command, *options = words
    for skipped, code in (([], 3), (["--skip-damaged"], 0)):
        assert run_app(["fleet", command, str(damaged), *options, *skipped]) == code
        error = capsys.readouterr().err
        assert error.startswith(f"fluxbench: {damaged}/part-000001.parquet: cannot be read as Parquet: ")
        assert error.count("\n") == 1


def test_the_report_counts_what_is_missing(damaged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["fleet", "report", str(damaged), "--json"]) == 3
    report = json.loads(capsys.readouterr().out)
    assert report["recordings"] == 20
    assert len(report["damaged"]) == 1
    page = (damaged / "_report" / "fleet-report.html").read_text(encoding="utf-8")
    assert "1 part of the table cannot be read" in page
