"""`fluxbench fleet`: many recordings as one table, and what it tells."""

from __future__ import annotations

from collections.abc import Sequence

import typer

from plugins.commands.fleet._report import report

app = typer.Typer(add_completion=False, rich_markup_mode=None)
app.command("report")(report)


@app.callback()
def fleet() -> None:
    """Many recordings as one table, and what it tells."""


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    return int(app(list(arguments), prog_name="fluxbench fleet", standalone_mode=False) or 0)
