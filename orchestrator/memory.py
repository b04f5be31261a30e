"""How much this machine has memory for; asked before it is read, for what a file says of its size may be anything."""

from __future__ import annotations

import resource
from pathlib import Path

from protocols import RecordingError

COPIES = 3
"""What decoding, aligning and working on a segment take, in sizes of its columns."""


def require_memory(path: Path, size: int, what: str, *, held: int = 0) -> None:
    """Raise `RecordingError` where something is more than the machine, or this process, can hold.

    Parameters
    ----------
    size : int
        Of the arrays that are to be worked on [bytes].
    what : str
        In the plural, such as "5000 rows".
    held : int
        So much of it is in memory already [bytes].
    """
    needed, spare = COPIES * size, spare_memory()
    if spare is not None and needed - held > spare:
        told = f"{what} take some {1e-9 * needed:.1f} GB of memory to work on, and {1e-9 * spare:.1f} GB are free"
        raise RecordingError(str(path), "", told)


def spare_memory() -> int | None:
    """Bytes that the machine has free and this process may take; None where the system does not tell."""
    found = [spare for spare in (_free_in_machine(), _left_of_address_space()) if spare is not None]
    return min(found) if found else None


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
