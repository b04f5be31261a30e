"""Checks of free memory before a file is read, because the size in a file may be anything."""

from __future__ import annotations

import resource
from pathlib import Path

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


def spare_memory() -> int | None:
    """Free bytes that this process may use; None where the system does not report them."""
    limits = [spare for spare in (_free_in_machine(), _left_of_address_space()) if spare is not None]
    return min(limits) if limits else None


def _free_in_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    values = dict(line.split(":", 1) for line in lines if ":" in line)
    available = values.get("MemAvailable")
    return None if available is None else 1024 * int(available.split()[0])


def _left_of_address_space() -> int | None:
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        return limit
    return max(0, limit - pages * resource.getpagesize())
