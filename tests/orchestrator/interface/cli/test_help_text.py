"""The help of every command: arguments by their names, no types of the program's own language."""

from __future__ import annotations

import pytest
import typer.main

from orchestrator.interface.cli._app import app
from orchestrator.interface.cli._running import run_app

COMMANDS = sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]


@pytest.mark.parametrize("command", [*COMMANDS, "report", "mystery", "fleet run"])
def test_help_names_arguments_and_values_without_types(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app([*command.split(), "-h"]) == 0
    out = capsys.readouterr().out
    usage = out.splitlines()[0]
    assert not set("<{") & set(usage)
    assert not any(typed in out for typed in ("<path>", "<str>", "<int", "<float", "<list"))


def test_an_option_s_value_has_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["tune", "--help"]) == 0
    assert "--speed-rpm NUMBER" in capsys.readouterr().out


@pytest.mark.parametrize(("command", "back"), [("add", "remove"), ("remove", "add")])
def test_help_of_a_refit_says_where_names_are_from_what_is_rewritten_and_what_undoes_it(
    command: str, back: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app([command, "--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "rewrites model.json and the report" in words
    assert f"`fluxbench {back} RECORDING NAME`" in words
    assert f"Example: fluxbench {command} runs/first NAME" in words


def test_quiet_has_one_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("run", "resume", "mystery"):
        assert run_app([command, "--help"]) == 0
        assert "-q, --quiet Print errors only." in " ".join(capsys.readouterr().out.split())
