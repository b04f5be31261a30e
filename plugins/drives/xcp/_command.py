"""`fluxbench xcp`: the C files that an ECU's fast routine calls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def xcp(directory: Annotated[Path, typer.Argument(help="Where to write them.", metavar="DIR")]) -> int:
    """Write the C routine for an ECU that the drive `xcp` measures and calibrates (docs/xcp.md)."""
    from plugins.drives.xcp._source import write_routine

    for path in write_routine(directory):
        print(path)
    return 0


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    return int(app(list(arguments), prog_name="fluxbench xcp", standalone_mode=False) or 0)
