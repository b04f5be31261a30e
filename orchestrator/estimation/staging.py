"""A folder in which results are prepared beside their place, locked while its process lives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from orchestrator.operating_system.locks import LOCK_NAME, locked_file


@contextmanager
def staging_folder(folder: Path, prefix: str) -> Iterator[Path]:
    """A temporary folder in `folder`, locked for this process while the block lasts; raises `OSError`.

    A kill leaves it without its lock; `orchestrator.runs.remove_stale_staging` knows the prefixes.
    """
    while True:
        with TemporaryDirectory(prefix=prefix, dir=folder, ignore_cleanup_errors=True) as name, ExitStack() as lock:
            file = Path(name) / LOCK_NAME
            try:
                lock.enter_context(locked_file(file))
            except (FileNotFoundError, BlockingIOError):
                continue  # another process removes it, which was new and not locked yet
            if file.exists():
                yield Path(name)
                return
