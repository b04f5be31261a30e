"""Errors of arguments: one line that names the argument, what was given and expected, and an example that is right."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import Any

import pytest
import typer
import typer.main

from orchestrator.interface.cli._app import app
from orchestrator.interface.cli._foreign import GROUP
from orchestrator.interface.cli._running import run_app
from orchestrator.interface.cli._usage import EXAMPLE


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            "tune runs/first --speed-rpm fast",
            "--speed-rpm: expected a number, got 'fast'; for example: fluxbench tune runs/first --speed-rpm 4000",
        ),
        ("mystery four", "NUMBER: expected a whole number, got 'four'; for example: fluxbench mystery 4"),
        ("mystery", "NUMBER is missing; for example: fluxbench mystery 4"),
        ("compare", "RECORDING is missing; for example: fluxbench compare runs/first --model saturated"),
        (
            "add runs/first",
            "NAME is missing; for example: fluxbench add runs/first NAME, with a name of `fluxbench effects`",
        ),
        ("campaign a.yaml", "--out is missing; for example: fluxbench campaign campaign.yaml --out power"),
        ("runs --limit x", "--limit: expected a whole number, got 'x'; for example: --limit 10"),
        ("run demo --rounds 0", "--rounds: expected a number from 1 on, got '0'; for example: --rounds 1"),
        ("emulate --node 9", "--node: expected a number up to 3, got '9'; for example: --node 0"),
        ("run --drive", "--drive: expected a value after it"),
        ("run --queue --json", "--queue: excludes --from, --out, --serial, --remote and --json"),
        (
            "import x.csv",
            "x.csv: a measurement without its mapping: `fluxbench import --guess x.csv` writes one, and --out names "
            "the new folder",
        ),
        ("runs --nonsense", "No such option: --nonsense; `fluxbench runs --help` lists what there is"),
        ("frobnicate", "No such command 'frobnicate'; `fluxbench --help` lists what there is"),
        (
            "explain runs/first runs/second",
            "runs/second: `fluxbench explain` takes one RUN; `fluxbench compare RUN RUN...` compares several",
        ),
        (
            "remove runs/first dead_time hysteresis",
            "hysteresis: `fluxbench remove` takes one RECORDING and one NAME; `fluxbench remove --help` lists its "
            "options",
        ),
        (
            "run demo limits.current_a=3",
            "limits.current_a=3: `fluxbench run` takes at most one PROCEDURE; a setting is given as "
            "`--set limits.current_a=3`",
        ),
        ("wire can", "can: `fluxbench wire` takes no argument; `fluxbench wire --help` lists its options"),
        (
            "diagnose runs/first --material-flux -1",
            "--material-flux: expected a number from 0 on, got '-1'; for example: --material-flux 0",
        ),
        (
            "benchmark",
            "fluxbench benchmark: expected a command: make, run, score; `fluxbench benchmark --help` describes them",
        ),
        (
            "run demo --junit nowhere/x.xml",
            "--junit: nowhere/x.xml: no such folder: nowhere",
        ),
        (
            "run demo --from runs/first",
            "--from: continues a run as it is: leave out PROCEDURE, --drive, --motor, --set, --out, --serial, "
            "--operator, --ambient, --tag and --note",
        ),
        ("schema motor x", "schema: x: a name goes with `schema drive` alone; `schema motor` needs none"),
        ("probe --serial /dev/nosuch", "--serial: /dev/nosuch: no such port; `fluxbench probe` alone looks on all"),
        (
            "export model.json --out pyproject.toml",
            "pyproject.toml: is not a directory and is not overwritten: name another place",
        ),
        ("diagnoze runs/first", "No such command 'diagnoze'. Did you mean 'diagnose'?"),
    ],
)
def test_a_wrong_argument_is_one_line_with_an_example(
    words: str, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(words.split()) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"fluxbench: {line}"


def commands(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Every command below one, with its call."""
    subs = getattr(command, "commands", None)
    if subs is None:
        yield path, command
    for name, sub in (subs or {}).items():
        yield from commands(sub, f"{path} {name}")


def applications() -> Iterator[tuple[str, typer.Typer]]:
    yield "fluxbench", app
    for entry in entry_points(group=GROUP):
        cells = getattr(entry.load(), "__closure__", None) or ()
        yield from (
            (f"fluxbench {entry.name}", c.cell_contents) for c in cells if isinstance(c.cell_contents, typer.Typer)
        )


def test_the_example_of_each_command_names_it_and_all_that_it_needs() -> None:
    seen = 0
    for path, application in applications():
        for call, command in commands(typer.main.get_command(application), path):
            assert (command.epilog or "").startswith(f"{EXAMPLE}{call}"), call
            words = shlex.split(command.epilog.removeprefix(f"{EXAMPLE}{call}"))
            options = [p for p in command.params if p.required and p.param_type_name == "option"]
            assert all(set(p.opts) & set(words) for p in options), call
            assert len(words) >= sum(p.required for p in command.params), call
            seen += 1
    assert seen > 30


def test_an_option_that_may_be_repeated_names_its_value_instead_of_a_python_type() -> None:
    for path, application in applications():
        for call, command in commands(typer.main.get_command(application), path):
            unnamed = [p.opts for p in command.params if p.multiple and p.metavar is None]
            assert not unnamed, f"{call}: {unnamed}"
