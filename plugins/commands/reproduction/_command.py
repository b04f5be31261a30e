"""`fluxbench reproduce`: the paper's experiment, figures and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point
from protocols import InputError

HELP_GROUP = "Try and prove"
"""Its place in the list of commands."""


def reproduce(
    run: Annotated[Path, typer.Option(help="Run directory: read if it exists, else created.", metavar="RUN")] = Path(
        "runs/paper"
    ),
    out: Annotated[Path, typer.Option(help="Folder for the page and its figures.", metavar="FOLDER")] = Path(
        "runs/paper-page"
    ),
    literal: Annotated[
        bool,
        typer.Option("--literal", help="Write a second page: the paper's own evaluation and its sources of error."),
    ] = False,
) -> int:
    """Run the paper's experiment on the simulated drive and write its figures and tables beside the printed ones."""
    from orchestrator.config import load_procedure
    from orchestrator.engine import AbsentOperator, RunServices, handling_signals, start_run
    from orchestrator.formatting.sentences import shown
    from orchestrator.runs import RunDirectory, is_run
    from plugins.commands.reproduction._material import collect
    from plugins.commands.reproduction._page import write_page

    if is_run(run) and RunDirectory.open(run).record.procedure.name != "paper":
        raise InputError("--run", str(run), "is a run of another procedure; name a new folder, or one of this command")
    if not is_run(run):
        with handling_signals() as interrupts:
            result = start_run(load_procedure("paper"), run, RunServices(AbsentOperator(), interrupts, {"console": {}}))
        if result.outcome.error is not None:
            raise result.outcome.error
    print(shown(str(write_page(collect(run), out, literal=literal))))
    if literal:
        print(shown(str(_literal_page(run, out))))
    return 0


def _literal_page(run: Path, out: Path) -> Path:
    from orchestrator.recording import open_recording
    from orchestrator.runs import RunDirectory
    from plugins.commands.reproduction.literal import budget, evaluate, measured_in, write_page

    measured = evaluate(measured_in(open_recording(run)))
    return write_page(measured, budget(RunDirectory.open(run).procedure(), measured), out)


command = entry_point(reproduce, "Example: fluxbench reproduce --out runs/paper-page")
