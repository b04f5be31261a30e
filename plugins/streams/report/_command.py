"""`fluxbench report`: write the report of a run, or of several side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.formatting.sentences import shown
from orchestrator.runs import RunDirectory, is_run, without_private
from plugins.command_line import entry_point
from plugins.streams.report._page import write_report

HELP_GROUP = "Use the results"
"""Its place in the list of commands."""


def report(
    directories: Annotated[
        list[Path], typer.Argument(help="A run, or a recording that was estimated; or several.", metavar="RUN...")
    ],
    out: Annotated[
        Path | None, typer.Option(help="The file to write; by default report.html in RUN, comparison.html of several.")
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write a PDF as well; needs Chromium on this machine.")] = False,
) -> int:
    """Write the report of a run or recording, or of several side by side: one self-contained page."""
    directories = without_private(directories)
    if len(directories) > 1:
        from plugins.streams.report._comparison_page import write_comparison

        page = write_comparison(directories, out)
    else:
        if is_run(directories[0]):
            RunDirectory.open(directories[0])  # raises where run.json is damaged: a page without it says too little
        page = write_report(directories[0], out, compares=True)
    print(shown(str(page)))
    if pdf:
        from plugins.streams.report._printing import print_page

        print(shown(str(print_page(page, page.with_suffix(".pdf")))))
    return 0


command = entry_point(report, "Example: fluxbench report runs/first")
