"""A folder in which results are prepared beside their place, locked while its process lives."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def staging_folder(folder: Path, prefix: str) -> Iterator[Path]:
    """A temporary folder in `folder`, locked for this process while the block lasts; raises `OSError`.

    A kill leaves it without its lock; `orchestrator.runs.remove_stale_staging` knows the prefixes.
    """
    while True:
        with TemporaryDirectory(prefix=prefix, dir=folder, ignore_cleanup_errors=True) as name:
            descriptor = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX)
                if not Path(name).is_dir():  # removed by another process before it was locked
                    continue
                yield Path(name)
                return
            finally:
                os.close(descriptor)
