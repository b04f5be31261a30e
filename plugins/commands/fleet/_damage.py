"""Parts of a fleet's table that cannot be read: each is named, and the exit code says that something is missing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

SkipDamaged = Annotated[
    bool,
    typer.Option("--skip-damaged", help="Exit with 0, not 3, although parts of the table cannot be read."),
]


def exit_code(damaged: Sequence[str], skip_damaged: bool) -> int:
    """Print a line for each damaged part on standard error; 3 where there is any, unless `skip_damaged`."""
    from orchestrator.formatting.sentences import shown

    for problem in damaged:
        print(shown(f"fluxbench: {problem}"), file=sys.stderr)
    return 3 if damaged and not skip_damaged else 0
