"""`fluxbench serve`: the operator's page, for a browser on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point

HELP_GROUP = "Measure"
"""Its place in the list of commands."""


HOST = "127.0.0.1"


def serve(
    folder: Annotated[
        Path, typer.Argument(help="Folder with procedures and motor files; runs go to runs/ in it.", metavar="FOLDER")
    ] = Path(),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0: any free port.")] = 0,
) -> int:
    """Start, follow, answer and stop runs from a browser on this machine. Ctrl-C ends the server and an active run."""
    from orchestrator.formatting.sentences import shown
    from plugins.commands.serve._server import serve_page
    from protocols import InputError

    if not folder.is_dir():
        raise InputError(shown(str(folder)), "", "no such folder")
    return serve_page(folder.resolve(), HOST, port)


command = entry_point(serve, "Example: fluxbench serve bench --port 8080")
