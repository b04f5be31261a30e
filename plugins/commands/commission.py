"""`fluxbench commission --until 0.2%`: measure a flux map to a given accuracy in the least time."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.formatting.sentences import shown
from plugins.command_line import entry_point
from protocols import InputError

if TYPE_CHECKING:
    from orchestrator.shelf import JudgedRun

HELP_GROUP = "Measure"
"""Its place in the list of commands."""


STREAMS = ("console", "report", "rerun")


def commission(
    until: Annotated[
        str, typer.Option(help="Half of the map's 95 % band, in percent of the rated flux.", metavar="P%")
    ] = "0.2%",
    drive: Annotated[
        str | None, typer.Option(help="Use this drive instead of the procedure's.", metavar="NAME")
    ] = None,
    motor: Annotated[
        Path | None, typer.Option(help="YAML file with another motor (and limits, drive, accept).", metavar="FILE")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting of the procedure.", metavar="K=V")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run directory; by default runs/adaptive-<time>.", metavar="FOLDER")
    ] = None,
    unattended: Annotated[
        str | None, typer.Option(help='"I have made the bench safe": no operator is present.', metavar="WORDS")
    ] = None,
    serial: Annotated[
        str | None, typer.Option(help="The motor's serial number; stored with the run.", metavar="NUMBER")
    ] = None,
    queue: Annotated[
        bool, typer.Option("--queue", help="Run motor after motor; ask for each one's serial number.")
    ] = False,
    junit: Annotated[
        Path | None, typer.Option(help="Write pass or fail by the section `accept` as JUnit XML.", metavar="FILE")
    ] = None,
) -> int:
    """Measure a flux map to a given accuracy: the procedure `adaptive`, with another target.

    Limits as --set accept.max_resistance_ohm=4.5 decide whether the motor passes; exit code 4 where it does not.
    """
    from orchestrator.config import load_procedure
    from orchestrator.engine import TerminalOperator
    from orchestrator.interface.api import run
    from orchestrator.runs import require_file_place
    from orchestrator.shelf import ask_serial, judge_run, run_folder_of, work_through, write_junit
    from plugins.stages.adaptive import AdaptiveStage
    from protocols import shipped_procedure

    if queue and (serial is not None or out is not None):
        raise InputError("--queue", "", "excludes --serial and --out")
    if junit is not None:
        require_file_place(junit, "--junit")
    kinds = re.findall(r"^  - kind: (\w+)", shipped_procedure(AdaptiveStage.name), re.MULTILINE)
    target = f"stages.{kinds.index(AdaptiveStage.name)}.until_percent={percent(until)}"
    operator = TerminalOperator() if unattended is None and sys.stdin.isatty() else None
    judged: list[JudgedRun] = []

    def run_motor(serial: str | None) -> int:
        label = [] if serial is None else [f"about.serial={json.dumps(serial)}"]
        overrides = [target, *(settings or []), *label]
        procedure = load_procedure(AdaptiveStage.name, overrides=overrides, drive=drive, motor=motor)
        place = run_folder_of(procedure.name, serial or "") if queue else out
        done = run(procedure, out=place, operator=operator, unattended=unattended, streams=STREAMS)
        judged.append(judge_run(done.path))
        if junit is not None:
            write_junit(junit, judged)
        return _print_judgement(judged[-1])

    if queue:
        return work_through(ask_serial, run_motor, _complain)
    return run_motor(serial)


def _print_judgement(judged: JudgedRun) -> int:
    if judged.acceptance is not None:
        print(shown(judged.label), flush=True)
        if not judged.acceptance.passed:
            _complain(f"not accepted: {'; '.join(judged.acceptance.objections)}")
    return judged.exit_code


def _complain(line: str) -> None:
    print(shown(f"fluxbench: {line}"), file=sys.stderr, flush=True)


def percent(text: str) -> float:
    """The number of a percentage; raises `InputError`."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*%\s*", text)
    if match is None or float(match[1]) <= 0.0:
        raise InputError("--until", "", f"{text!r}; expected a percentage, such as 0.2%")
    return float(match[1])


command = entry_point(commission, "Example: fluxbench commission --out runs/adaptive")


command.energises = True  # type: ignore[attr-defined]  # a function may have any
