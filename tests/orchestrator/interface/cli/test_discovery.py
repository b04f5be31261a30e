"""The program lists its own plugins, procedures and formats."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.support.processes import called

PAGE = Path(__file__).parents[4] / "docs" / "simulated.md"


def test_alone_it_says_in_a_few_lines_how_to_begin() -> None:
    done = called()
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) <= 12
    assert "fluxbench check demo" in done.stdout


def test_the_version_is_the_distribution_s() -> None:
    assert called("--version").stdout == f"fluxbench {version('fluxbench')}\n"


def test_a_shell_gets_its_completion_and_what_might_come_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))  # whatever started the tests
    shown = called("--show-completion")
    assert (shown.returncode, "complete -o default" in shown.stdout) == (0, True)
    for name, value in {"": "complete_bash", "COMP_WORDS": "fluxbench proc", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name or "_FLUXBENCH_COMPLETE", value)
    completed = called()
    assert (completed.returncode, completed.stdout.split()) == (0, ["procedures"])


@pytest.mark.parametrize(("command", "name"), [("effects", "dead_time"), ("procedures", "demo")])
def test_effects_and_procedures_have_a_line_each(command: str, name: str) -> None:
    rows = json.loads(called(command, "--json").stdout)
    lines = called(command).stdout.splitlines()
    assert len(lines) == len(rows)
    assert all(row["summary"] for row in rows)
    assert name in {row["name"] for row in rows}


def test_a_new_package_is_reported_as_json_too(tmp_path: Path) -> None:
    result = json.loads(called("new", "effect", "mine", "--out", tmp_path / "new", "--json").stdout)
    assert result["folder"] == str(tmp_path / "new")
    assert all(Path(file).is_file() for file in result["files"])


def test_every_option_of_the_simulated_drive_is_on_its_page() -> None:
    table = called("schema", "drive", "simulated", "--table").stdout
    assert table in PAGE.read_text(), "write it anew with `fluxbench schema drive simulated --table`"
    assert "| `plant.magnetics.file` |" in table


def test_a_schema_of_a_drive_needs_its_name() -> None:
    assert called("schema", "drive").returncode == 2
    assert called("schema", "drive", "nobodys").returncode == 2
