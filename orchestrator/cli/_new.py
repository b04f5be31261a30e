"""`fluxbench new`: a package for a plugin of one's own."""

from __future__ import annotations

import shlex
from pathlib import Path

from orchestrator.cli._output import say
from orchestrator.scaffolding import write_package


def new(kind: str, name: str, out: Path | None) -> int:
    """Write the package and say what to do with it."""
    folder = out if out is not None else Path(f"fluxbench-{name.replace('_', '-')}")
    for path in write_package(kind, name, folder):
        say(str(path))
    say(f"next: cd {shlex.quote(str(folder))} && pip install -e . && pytest tests")
    return 0
