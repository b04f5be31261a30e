"""A run knows what it is of, and is found by it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from plugins.streams.report import write_report
from protocols import RunStarted
from tests.support.processes import called
from tests.support.tiny import messages_of, tiny_file

SAID = (
    "--serial",
    "PM-0042",
    "--operator",
    "M. Faraday",
    "--ambient",
    "0",
    "--tag",
    "cold",
    "--note",
    "before rewinding",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs, one of which says what it is of."""
    path = tmp_path_factory.mktemp("runs")
    procedure = tiny_file(path, stages=[{"kind": "gates_off", "duration_s": 0.02}])
    assert called("run", procedure, "--out", path / "runs" / "one", "--quiet", *SAID).returncode == 0
    assert called("run", procedure, "--out", path / "runs" / "two", "--quiet").returncode == 0
    return path


def test_what_a_run_is_of_stands_in_its_journal_and_on_its_report(folder: Path) -> None:
    (started,) = [m for m in messages_of(folder / "runs" / "one") if isinstance(m, RunStarted)]
    assert (started.about.serial, started.about.ambient_c, started.about.notes) == (
        "PM-0042",
        0.0,
        ("before rewinding",),
    )
    page = write_report(folder / "runs" / "one").read_text()
    assert "serial PM-0042; operator M. Faraday; ambient 0 °C; tags cold; notes before rewinding" in page


def test_runs_are_listed_and_searched_by_words(folder: Path) -> None:
    whole = called("runs", cwd=folder)
    assert whole.returncode == 0
    assert all(word in whole.stdout for word in ("PM-0042", "runs/two", "finished", "400 W test PMSM"))
    found = json.loads(called("runs", "pm-0042", "COLD", "--json", cwd=folder).stdout)
    assert [row["run"] for row in found] == ["runs/one"]
    assert "no run below runs has the words warm" in called("runs", "warm", cwd=folder).stdout
    (folder / "elsewhere").mkdir()
    message = called("runs", "elsewhere", cwd=folder).stdout
    assert message.endswith("; `fluxbench runs --folder elsewhere` lists those below elsewhere\n")


def test_a_folder_that_is_not_there_and_a_damaged_run_are_stated(folder: Path, tmp_path: Path) -> None:
    assert called("runs", "--folder", tmp_path / "none").returncode == 2
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "run.json").write_text("{")
    done = called("runs", "--folder", tmp_path)
    assert (done.returncode, "broken JSON" in done.stderr) == (3, True)


def test_a_run_that_cannot_be_read_is_named_and_the_exit_code_says_so(folder: Path) -> None:
    broken = folder / "runs" / "broken"
    broken.mkdir()
    (broken / "run.json").write_text("{")
    try:
        listed = called("runs", cwd=folder)
        assert listed.returncode == 3
        assert "runs/two" in listed.stdout
        assert listed.stderr.startswith("fluxbench: runs/broken/run.json: broken JSON")
        assert listed.stderr.count("\n") == 1
        skipped = called("runs", "--skip-damaged", cwd=folder)
        assert (skipped.returncode, skipped.stdout, skipped.stderr) == (0, listed.stdout, listed.stderr)
    finally:
        (broken / "run.json").unlink()
        broken.rmdir()


def test_runs_are_filtered_by_columns_and_printed_in_those_that_are_wanted(folder: Path) -> None:
    listed = called("runs", "--where", "serial=pm-0042", "--columns", "run,drive,outcome,resistance_ohm", cwd=folder)
    head, _, row = listed.stdout.splitlines()
    assert head.split() == ["run", "drive", "outcome", "resistance_ohm"]
    assert row.split() == ["runs/one", "simulated", "finished", "–"]
    found = json.loads(
        called("runs", "--sort=-run", "--limit", "1", "--columns", "run,l_dd_h", "--json", cwd=folder).stdout
    )
    assert found == [{"run": "runs/two", "l_dd_h": None, "l_dd_low_h": None, "l_dd_high_h": None}]
    assert "has resistance_ohm>1" in called("runs", "--where", "resistance_ohm>1", cwd=folder).stdout
    for option, value in (("--where", "serial"), ("--columns", "run,serail"), ("--sort", "colour")):
        refused = called("runs", option, value, cwd=folder)
        assert refused.returncode == 2
        assert refused.stderr.startswith(f"fluxbench: {option}: ")
        assert refused.stderr.count("\n") == 1


def test_all_texts_of_the_former_list_are_still_there_as_json(folder: Path) -> None:
    (row,) = json.loads(called("runs", "pm-0042", "--json", cwd=folder).stdout)
    expected = {
        "run": "runs/one",
        "procedure": "tiny",
        "motor": "400 W test PMSM",
        "outcome": "finished",
        "serial": "PM-0042",
        "operator": "M. Faraday",
        "ambient": "0 °C",
        "tags": "cold",
        "notes": "before rewinding",
    }
    assert {name: row[name] for name in expected} == expected
    assert row["duration_s"] > 0.0


def test_notes_and_tags_are_added_later_and_found(folder: Path) -> None:
    given = called("note", "runs/two", "magnet lost", "--tag", "returned", cwd=folder)
    assert given.stdout == "tags: returned\nnote: magnet lost\n"
    assert "runs/two" in called("runs", "magnet", "returned", cwd=folder).stdout
    removed = called("note", "runs/two", "--untag", "returned", "--json", cwd=folder)
    assert json.loads(removed.stdout) == {"tags": [], "notes": ["magnet lost"]}
    refused = called("note", "runs/three", "x", cwd=folder)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    (folder / "runs" / "two" / "labels.json").unlink()


def test_a_damaged_index_is_replaced_without_a_word(folder: Path) -> None:
    before = called("runs", cwd=folder)
    (folder / "runs" / ".index.sqlite").write_text("damaged")
    after = called("runs", cwd=folder)
    assert (after.returncode, after.stdout, after.stderr) == (0, before.stdout, "")
