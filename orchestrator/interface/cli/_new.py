"""`fluxbench new`: a package for a new plugin."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

from orchestrator.interface.cli._output import say, say_document
from orchestrator.interface.scaffolding import write_package


def new(kind: str, name: str, out: Path | None, as_json: bool = False) -> int:
    """Write the package and print the next steps."""
    folder = out if out is not None else Path(f"fluxbench-{name.replace('_', '-')}")
    written = [str(path) for path in write_package(kind, name, folder)]
    if as_json:
        say_document(json.dumps({"folder": str(folder), "files": written}, indent=2))
        return 0
    say(*written)
    python = shlex.quote(sys.executable)
    install, test = f"{python} -m pip install -e . pytest", f"{python} -m pytest tests"
    say(f"next: cd {shlex.quote(str(folder))} && {install} && {test}")
    return 0
