"""Files: durable on the disk, replaced at once, opened without any translation of line ends."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

BINARY: int = getattr(os, "O_BINARY", 0)
"""Flag for `os.open`: Windows would translate line ends otherwise."""
NON_BLOCKING: int = getattr(os, "O_NONBLOCK", 0)
"""Flag for `os.open`: a pipe without a writer opens at once."""
IS_WINDOWS = os.name == "nt"
MAX_REPLACE_WAIT_S = 2.0
"""Time in which a file on Windows is replaced although a reader, such as a virus scanner, has it open for a moment."""


def sync_content(descriptor: int) -> None:
    """Bring a file's content, and its size, to the disk; raises `OSError`."""
    getattr(os, "fdatasync", os.fsync)(descriptor)


def sync_folder(folder: Path) -> None:
    """Make a rename in `folder` survive a power cut; Windows opens no folders, and needs none of this."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace(source: Path, target: Path) -> None:
    """Rename a file to `target`, in the place of one that is there; raises `OSError`."""
    deadline = time.monotonic() + MAX_REPLACE_WAIT_S
    while True:
        try:
            source.replace(target)
            return
        except PermissionError:
            if not IS_WINDOWS or time.monotonic() > deadline:
                raise
            time.sleep(0.02)


def free_bytes(folder: Path) -> int | None:
    """Free space where a folder is, or will be made; None where the system does not report it."""
    present = next(place for place in (folder, *folder.parents) if place.exists())
    try:
        return shutil.disk_usage(present).free
    except OSError:
        return None
