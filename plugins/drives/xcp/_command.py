"""`fluxbench xcp`: the C files that an ECU's fast routine calls."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point


def xcp(directory: Annotated[Path, typer.Argument(help="Where to write them.", metavar="DIR")]) -> int:
    """Write the C routine for an ECU that the drive `xcp` measures and calibrates (docs/xcp.md)."""
    from plugins.drives.xcp._source import write_routine

    for path in write_routine(directory):
        print(path)
    return 0


command = entry_point(xcp)
