"""Memory that this process may still use, and the most that it has used."""

from __future__ import annotations

import sys
from pathlib import Path


def spare_memory() -> int | None:
    """Free bytes that this process may use; None where the system does not report them."""
    limits = [spare for spare in (_free_in_machine(), _left_of_address_space()) if spare is not None]
    return min(limits) if limits else None


def peak_memory() -> int | None:
    """Largest number of bytes that this process has had in memory; None where the system does not report it."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _free_in_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    values = dict(line.split(":", 1) for line in lines if ":" in line)
    available = values.get("MemAvailable")
    return None if available is None else 1024 * int(available.split()[0])


def _left_of_address_space() -> int | None:
    try:
        import resource
    except ImportError:
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        return limit
    return max(0, limit - pages * resource.getpagesize())
