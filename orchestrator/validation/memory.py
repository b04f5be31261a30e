"""Checks of free memory before a file is read, because the size in a file may be anything."""

from __future__ import annotations

from pathlib import Path

from orchestrator.operating_system.memory import spare_memory
from protocols import RecordingError

COPIES_PER_SEGMENT = 3
"""Memory for decoding, aligning and analysing a segment, in sizes of its columns."""


def require_memory(path: Path, size: int, what: str, *, held: int = 0) -> None:
    """Raise `RecordingError` where data need more memory than the machine, or this process, has.

    Parameters
    ----------
    size : int
        Size of the arrays [bytes].
    what : str
        Description in the plural, such as "5000 rows".
    held : int
        Part that is in memory already [bytes].
    """
    needed, spare = COPIES_PER_SEGMENT * size, spare_memory()
    if spare is not None and needed - held > spare:
        problem = f"{what} need some {1e-9 * needed:.1f} GB of memory, and {1e-9 * spare:.1f} GB are free"
        raise RecordingError(str(path), "", problem)
