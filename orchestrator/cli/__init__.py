"""The command line: words in, one call into the rest, words out."""

import gc
import os
import sys

COLLECTED_EVERY = 50_000
"""Objects between two collections: with Python's 700 they take a tenth of a command that mostly imports."""


def main() -> None:
    """Entry point of `fluxbench`: exit 0 done, 2 bad input, 3 the run ended in a fault, 130 interrupted."""
    from orchestrator.cli._early_signals import EarlySignals

    gc.set_threshold(COLLECTED_EVERY)
    signals = EarlySignals()  # before anything is imported that takes time
    from orchestrator.cli._leaving import leave
    from orchestrator.cli._quiet import hush_libraries
    from orchestrator.cli._running import run_app

    hush_libraries()

    # Before numpy is there: threads of a BLAS wait for each other by spinning, which on busy cores costs many times
    # more than they bring to matrices as small as these. Who has set a number keeps it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    leave(run_app(sys.argv[1:], signals.settle))


__all__ = ["main"]
