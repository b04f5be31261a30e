"""`fluxbench serve`: the operator's page, for a browser on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(add_completion=False, rich_markup_mode=None)

HOST = "127.0.0.1"


@app.command()
def serve(
    folder: Annotated[
        Path, typer.Argument(help="Whose procedures and motors are offered, and where runs/ is.")
    ] = Path(),
    port: Annotated[int, typer.Option(min=0, max=65535, help="To listen on; 0: any that is free.")] = 0,
) -> int:
    """Start, follow, answer and stop runs from a browser on this machine. Ctrl-C ends it, and a run that is going."""
    from orchestrator.formatting.sentences import shown
    from plugins.commands.serve._server import serve_page
    from protocols import InputError

    if not folder.is_dir():
        raise InputError(shown(str(folder)), "", "no such folder")
    return serve_page(folder.resolve(), HOST, port)


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    return int(app(list(arguments), prog_name="fluxbench serve", standalone_mode=False) or 0)
