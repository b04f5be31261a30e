"""The process around a command: silent libraries at its start, and its end despite a stream that still waits."""

from __future__ import annotations

import os
import sys
import warnings
from contextlib import suppress
from typing import NoReturn


def silence_libraries() -> None:
    """Show neither Python's warnings, unless the user asks for them (``python -W``), nor errors of destructors.

    A command prints one line about an error; h5netcdf, for one, adds eight lines for each damaged file.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        sys.unraisablehook = lambda unraisable: None  # an error that could not be raised has changed nothing


def leave(code: int) -> NoReturn:
    """End the process; at once where a stream was given up, because its library may wait for ever."""
    streaming = sys.modules.get("orchestrator.engine.streaming")
    if streaming is not None and streaming.has_unfinished_streams():
        for output in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # the reader has ended
                output.flush()
        os._exit(code)
    sys.exit(code)
