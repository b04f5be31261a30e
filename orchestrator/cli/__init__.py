"""The command line: words in, one call into the rest, words out."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn


def main() -> None:
    """Entry point of `fluxbench`: exit 0 done, 2 bad input, 3 the run ended in a fault, 130 interrupted."""
    from orchestrator.cli._app import run_app

    # Before numpy is there: threads of a BLAS wait for each other by spinning, which on busy cores costs many times
    # more than they bring to matrices as small as these. Who has set a number keeps it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    leave(run_app(sys.argv[1:]))


def leave(code: int) -> NoReturn:
    """End the process; at once where a stream was given up, for its library may wait for it for ever."""
    streaming = sys.modules.get("orchestrator.streaming")
    if streaming is not None and streaming.has_unfinished_streams():
        for output in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # nobody reads it any more
                output.flush()
        os._exit(code)
    sys.exit(code)


__all__ = ["main"]
