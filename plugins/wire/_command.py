"""`fluxbench wire`: the drive protocol's page, DBC, C codec or firmware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point

HELP_GROUP = "Look up and extend"
"""Its place in the list of commands."""


def wire(
    c: Annotated[Path | None, typer.Option("--c", help="Write the C codec for firmware here.", metavar="DIR")] = None,
    firmware: Annotated[
        Path | None, typer.Option("--firmware", help="Write the reference firmware here, codec and all.", metavar="DIR")
    ] = None,
    dbc: Annotated[bool, typer.Option("--dbc", help="Print the DBC instead.")] = False,
    node: Annotated[int, typer.Option(min=0, max=3, help="Node number for the identifiers in the DBC.")] = 0,
) -> int:
    """Print the page that documents the drive protocol, or write what firmware needs of it."""
    if firmware is not None:
        from plugins.wire._firmware import write_firmware

        for path in write_firmware(firmware):
            print(path)
    elif c is not None:
        from plugins.wire._firmware import write_codec

        for path in write_codec(c):
            print(path)
    elif dbc:
        from plugins.wire._dbc import dbc_text

        print(dbc_text(node), end="")
    else:
        from plugins.wire._page import page

        print(page(), end="")
    return 0


command = entry_point(wire, "Example: fluxbench wire --dbc")
