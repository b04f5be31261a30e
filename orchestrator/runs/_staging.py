"""Folders in which results are prepared beside their place; the next command removes those that a kill has left.

Whoever makes one locks it for as long as its process lives (`orchestrator.estimation.staging_folder`).
"""

from __future__ import annotations

import fcntl
import os
import shutil
from contextlib import suppress
from pathlib import Path

STAGING = (".estimating-", ".view-")
"""Beginnings of their names."""


def remove_stale_staging(folder: Path) -> None:
    """Remove the staging folders that no process has locked; what cannot be removed stays."""
    for prefix in STAGING:
        for left in folder.glob(f"{prefix}*"):
            with suppress(OSError):
                descriptor = os.open(left, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(left, ignore_errors=True)
                finally:
                    os.close(descriptor)
