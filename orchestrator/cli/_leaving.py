"""The end of the process, whatever a stream's library is still waiting for."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn


def leave(code: int) -> NoReturn:
    """End the process; at once where a stream was given up, for its library may wait for it for ever."""
    streaming = sys.modules.get("orchestrator.streaming")
    if streaming is not None and streaming.has_unfinished_streams():
        for output in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # nobody reads it any more
                output.flush()
        os._exit(code)
    sys.exit(code)
