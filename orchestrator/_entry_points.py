"""Entry points of what is installed: every distribution's are read once, and again when something is installed."""

from __future__ import annotations

import sys
from functools import lru_cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Any


def entries_of(group: str) -> EntryPoints:
    """The entry points of a group, as `importlib.metadata` finds them; nothing is imported."""
    found: EntryPoints = _all_of(tuple((place, _changed(place)) for place in sys.path)).select(group=group)
    return found


@lru_cache(maxsize=1)
def _all_of(_places: tuple[tuple[str, int], ...]) -> Any:
    """All of them; where the path is another, or a folder of it has changed, they are read anew.

    Their collection is of another type before Python 3.12, and is selected from in the same way.
    """
    return entry_points()


def _changed(place: str) -> int:
    try:
        return Path(place or ".").stat().st_mtime_ns
    except OSError:
        return 0
