"""Folders in which results are prepared beside their place; the next command removes those that a kill has left.

Whoever makes one locks it for as long as its process lives (`orchestrator.estimation.staging_folder`).
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

from orchestrator.operating_system.locks import LOCK_NAME, locked_file

STAGING = (".estimating-", ".view-")
"""Beginnings of their names."""


def remove_stale_staging(folder: Path) -> None:
    """Remove the staging folders that no process has locked; what cannot be removed stays."""
    for prefix in STAGING:
        for left in folder.glob(f"{prefix}*"):
            if left.is_dir() and not left.is_symlink():
                with suppress(OSError):
                    _remove(left)


def _remove(left: Path) -> None:
    """Remove a folder; raises `OSError` where another process has locked it."""
    with locked_file(left / LOCK_NAME):
        shutil.rmtree(left, ignore_errors=True)
    if left.is_dir():  # Windows removes no file that is open, such as the lock
        (left / LOCK_NAME).unlink()
        left.rmdir()
