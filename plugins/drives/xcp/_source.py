"""The C files for the ECU, as they stand in the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from orchestrator.recording import replace_file
from protocols import InputError

NAMES = ("fluxbench_config.h", "fluxbench_xcp.h", "fluxbench_xcp.c")


def write_routine(directory: Path) -> tuple[Path, ...]:
    """Write them, each whole or not at all, and return their paths.

    A `fluxbench_config.h` that is there already is somebody's, and stays.

    Raises
    ------
    InputError
        The directory cannot be made, or nothing can be written to it.
    StorageError
        The disk is full.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("DIR", str(directory), f"cannot be made: {error.strerror or error}") from None
    written = []
    for name in NAMES:
        path = directory / name
        if name == NAMES[0] and path.exists():
            continue
        replace_file(path, (files("plugins.drives.xcp") / "firmware" / name).read_bytes())
        written.append(path)
    return tuple(written)
