"""`fluxbench commission --until 0.2%`: a flux map of a given accuracy in as little motor time as possible."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point
from protocols import InputError


def commission(
    until: Annotated[
        str, typer.Option(help="Half of the map's 95 % band, in percent of the rated flux.", metavar="P%")
    ] = "0.2%",
    drive: Annotated[str | None, typer.Option(help="Use this drive instead of the procedure's.")] = None,
    motor: Annotated[Path | None, typer.Option(help="YAML file with another motor (and limits, drive).")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Change one setting of the procedure.", metavar="K=V")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Run directory; by default runs/adaptive-<time>.")] = None,
    unattended: Annotated[
        str | None, typer.Option(help='"I have made the bench safe": no operator is present.', metavar="WORDS")
    ] = None,
) -> int:
    """Measure a flux map to a given accuracy: the procedure `adaptive`, with another target."""
    from orchestrator.config import load_procedure
    from orchestrator.engine import TerminalOperator
    from orchestrator.interface.api import run
    from plugins.stages.adaptive import AdaptiveStage
    from protocols import shipped_procedure

    kinds = re.findall(r"^  - kind: (\w+)", shipped_procedure(AdaptiveStage.name), re.MULTILINE)
    target = f"stages.{kinds.index(AdaptiveStage.name)}.until_percent={percent(until)}"
    procedure = load_procedure(AdaptiveStage.name, overrides=[target, *(settings or [])], drive=drive, motor=motor)
    operator = TerminalOperator() if unattended is None and sys.stdin.isatty() else None
    run(procedure, out=out, operator=operator, unattended=unattended, streams=("console", "report", "rerun"))
    return 0


def percent(text: str) -> float:
    """The number of a percentage; raises `InputError`."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*%\s*", text)
    if match is None or float(match[1]) <= 0.0:
        raise InputError("fluxbench commission", "--until", f"{text!r}; expected a percentage, such as 0.2%")
    return float(match[1])


command = entry_point(commission)


command.energises = True  # type: ignore[attr-defined]  # a function may have any
