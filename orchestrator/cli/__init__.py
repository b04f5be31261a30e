"""The command line: words in, one call into the rest, words out."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Entry point of `fluxbench`: exit 0 done, 2 bad input, 3 the run ended in a fault, 130 interrupted."""
    from orchestrator.cli._app import run_app

    # Before numpy is there: threads of a BLAS wait for each other by spinning, which on busy cores costs many times
    # more than they bring to matrices as small as these. Who has set a number keeps it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(run_app(sys.argv[1:]))


__all__ = ["main"]
