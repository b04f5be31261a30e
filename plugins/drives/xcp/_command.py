"""`fluxbench xcp`: the C files that an ECU's fast routine calls."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from plugins.command_line import entry_point

HELP_GROUP = "Look up and extend"
"""Its place in the list of commands."""


NAMES = ("fluxbench_config.h", "fluxbench_xcp.h", "fluxbench_xcp.c")


def write_routine(directory: Path) -> tuple[Path, ...]:
    """Write the C files atomically and return their paths.

    An existing `fluxbench_config.h` is not overwritten.

    Raises
    ------
    InputError
        The directory cannot be created or written to.
    StorageError
        The disk is full.
    """
    from orchestrator.recording import replace_file
    from protocols import InputError

    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("DIR", str(directory), f"cannot be created: {error.strerror or error}") from None
    written = []
    for name in NAMES:
        path = directory / name
        if name == NAMES[0] and path.exists():
            continue
        replace_file(path, (files("plugins.drives.xcp") / "firmware" / name).read_bytes())
        written.append(path)
    return tuple(written)


def xcp(
    directory: Annotated[Path, typer.Argument(help="Folder to write the routine's files to.", metavar="DIR")],
) -> int:
    """Write the C routine for an ECU that the drive `xcp` measures and calibrates (docs/xcp.md)."""
    for path in write_routine(directory):
        print(path)
    return 0


command = entry_point(xcp, "Example: fluxbench xcp ecu")
