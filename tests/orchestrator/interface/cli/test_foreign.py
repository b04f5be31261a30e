"""Commands of plugins in the list of commands: each has a line of its own, and none is imported for it."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest

from orchestrator.interface.cli._foreign import GROUP, described
from orchestrator.interface.cli._running import run_app
from orchestrator.interface.cli.help_text import GROUPS


def entry(value: str) -> EntryPoint:
    return EntryPoint("mine", value, GROUP)


def a_module(folder: Path, text: str) -> EntryPoint:
    package = folder / "some_foreign_package"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    (package / "command.py").write_text(text)
    return entry("some_foreign_package.command:command")


def test_every_command_of_the_projects_own_says_what_it_does() -> None:
    for one in entry_points(group=GROUP):
        if one.dist is not None and one.dist.name == "fluxbench":
            assert not described(one)[0].startswith("A plugin's"), one.name
            assert described(one)[0].endswith(".")


def test_the_list_of_commands_shows_each_one_s_summary_whole(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["--help"]) == 0
    commands = capsys.readouterr().out.split("Measure:")[1].strip().splitlines()
    assert len(commands) > 30
    assert [line for line in commands if line.endswith("...")] == []


def test_the_list_of_commands_is_in_groups_and_no_command_of_the_project_is_among_the_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_app(["--help"]) == 0
    out = capsys.readouterr().out
    titles = [line.rstrip(":") for line in out.splitlines() if line and not line.startswith((" ", "Usage"))]
    assert titles == ["Options", *GROUPS[:-1]]


@pytest.mark.parametrize(("line", "group"), [('HELP_GROUP = "Measure"', "Measure"), ("HELP_GROUP = 3", ""), ("", "")])
def test_a_plugins_command_names_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, group: str
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert described(a_module(tmp_path, f'"""Dig."""\n{line}\n')) == ("Dig.", group)


def test_the_first_line_of_the_module_is_read_and_nothing_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    mine = a_module(tmp_path, '"""`fluxbench mine X`: dig for `coal`.\n\nMore."""\nraise RuntimeError\n')
    assert described(mine)[0] == "Dig for `coal`."
    assert "some_foreign_package" not in sys.modules


@pytest.mark.parametrize("text", ["", "x = 1", "def (", "\0"])
def test_where_nothing_is_stated_its_origin_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert described(a_module(tmp_path, text))[0] == "A plugin's, from ?."


def test_a_module_that_there_is_not_is_no_error() -> None:
    assert described(entry("no_such_package.command:command"))[0] == "A plugin's, from ?."
