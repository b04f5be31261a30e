"""Commands that take their time say at once what they read."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from orchestrator.interface.cli._app import app

MORE = {"add": ["dead_time"], "remove": ["dead_time"]}
HEAVY = (
    "orchestrator.interface.cli._results",
    "orchestrator.interface.cli._diagnosis",
    "orchestrator.interface.cli._comparison",
)


@pytest.mark.parametrize("json", [False, True])
@pytest.mark.parametrize("command", ["estimate", "diagnose", "compare", "add", "remove"])
def test_a_line_is_out_before_anything_heavy_is_imported(
    command: str, json: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in HEAVY:
        monkeypatch.setitem(sys.modules, name, None)  # to import it now is an ImportError
    done = CliRunner().invoke(app, [command, str(tmp_path), *MORE.get(command, []), *(["--json"] if json else [])])
    assert isinstance(done.exception, ImportError)
    line = f"reading {tmp_path}\n"
    assert (done.stdout, done.stderr) == (("", line) if json else (line, ""))


def test_nothing_is_stated_of_what_is_not_there(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["estimate", str(tmp_path / "nowhere")])
    assert done.stdout == ""


def test_each_of_several_runs_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in HEAVY:
        monkeypatch.setitem(sys.modules, name, None)
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
    done = CliRunner().invoke(app, ["compare", str(tmp_path / "a"), str(tmp_path / "b")])
    assert done.stdout.splitlines() == [f"reading {tmp_path / run}" for run in "ab"]


@pytest.mark.parametrize(
    ("words", "out", "err"),
    [
        (["run", "nosuch"], "loading nosuch\n", ""),
        (["run"], "loading demo\n", ""),
        (["run", "--from", "a"], "", ""),  # a foreign recording's stage to paste follows alone
        (["resume", "a"], "loading a\n", ""),
        (["run", "--json"], "", "loading demo\n"),
        (["run", "--log", "json"], "", "loading demo\n"),
        (["run", "--quiet"], "", ""),
        (["run", "--remote", "page"], "", ""),
    ],
)
def test_a_run_states_what_it_loads_before_anything_heavy_is_imported(
    words: list[str], out: str, err: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "orchestrator.interface.cli._commission", None)
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, ImportError)
    assert (done.stdout, done.stderr) == (out, err)


def test_private_folders_that_a_pattern_includes_are_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "orchestrator.interface.cli._diagnosis", None)
    for name in ("run", "run.sealed", "gone.sealed", "gone.sealed.1"):
        (tmp_path / name).mkdir()
    done = CliRunner().invoke(app, ["compare", *map(str, sorted(tmp_path.iterdir(), reverse=True))])
    assert isinstance(done.exception, ImportError)  # one run is left: it is compared with its model
    assert done.stdout == f"reading {tmp_path / 'run'}\n"


def test_a_manifest_that_is_damaged_and_read_from_the_journal_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in HEAVY:
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "journal.jsonl").touch()
    (tmp_path / "recording.json").write_text('{"format": "fluxbench-reco')
    done = CliRunner().invoke(app, ["diagnose", str(tmp_path)])
    assert f"note: {tmp_path / 'recording.json'} is damaged" in done.stdout
    (tmp_path / "recording.json").write_text("{}")
    assert "damaged" not in CliRunner().invoke(app, ["diagnose", str(tmp_path)]).stdout
