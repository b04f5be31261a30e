"""The command line: words in, one call into the rest, words out."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point of `fluxbench`: exit 0 done, 2 bad input, 3 the run ended in a fault, 130 interrupted."""
    from orchestrator.cli._app import run_app

    sys.exit(run_app(sys.argv[1:]))


__all__ = ["main"]
