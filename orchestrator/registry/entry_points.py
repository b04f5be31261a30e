"""Entry points of installed distributions, read once, and again after an installation."""

from __future__ import annotations

import sys
from functools import lru_cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Any


def entries_of(group: str) -> EntryPoints:
    """The entry points of a group, as `importlib.metadata` finds them; nothing is imported."""
    entries: EntryPoints = _all_of(tuple((place, _changed_ns(place)) for place in sys.path)).select(group=group)
    return entries


@lru_cache(maxsize=1)
def _all_of(_places: tuple[tuple[str, int], ...]) -> Any:
    """All entry points, read again where the path or a folder in it has changed; of another type before Python 3.12."""
    return entry_points()


def _changed_ns(place: str) -> int:
    try:
        return Path(place or ".").stat().st_mtime_ns
    except OSError:
        return 0
