"""The command line: it parses options, makes one call, mostly into `orchestrator.interface.api`, and prints."""

import gc
import os
import sys

OBJECTS_PER_COLLECTION = 50_000
"""Objects between two collections: with Python's 700 they take a tenth of a command that mostly imports."""


def main() -> None:
    """Entry point of `fluxbench`: exit 0 done, 2 bad input, 3 fault, 4 motor not accepted, 130 interrupted."""
    try:
        from orchestrator.interface.cli._early_signals import EarlySignals

        signals = EarlySignals()  # before any slow import
    except KeyboardInterrupt:  # in the few milliseconds before
        os.write(2, b"fluxbench: interrupted by SIGINT\n")
        os._exit(130)
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    from orchestrator.interface.cli._process import leave, silence_libraries
    from orchestrator.interface.cli._running import run_app

    silence_libraries()

    # Before numpy is imported: threads of a BLAS wait for each other by spinning, which on busy cores costs far more
    # than they gain with matrices as small as these. A number that the user has set stays.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    leave(run_app(sys.argv[1:], signals.settle))


__all__ = ["main"]
