"""Standard output that can no longer be written: a full disk behind it, or a reader that has gone."""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def give_up_broken_output() -> None:
    """Flush standard output; where that fails, let what is left in it go, so that nothing complains at the end."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
