"""Compiles kernels once, into their caches: processes that begin together would all do it.

A small run with a diagnosis calls nearly all of them; `make test` runs this where a kernel's source has changed. With
``--diagnosis`` a small recording is diagnosed instead: `make demo` has this done, at first, while it measures.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import fluxbench

RECORDING = Path(__file__).parents[1] / "data" / "pm400-reduced"


def main(arguments: list[str]) -> None:
    """Compile all kernels, or those of a diagnosis alone."""
    with tempfile.TemporaryDirectory() as folder:
        if arguments == ["--diagnosis"]:
            fluxbench.diagnose(shutil.copytree(RECORDING, Path(folder) / "recording"), workers=1)
            return
        from tests.support.tiny import STAGES, run_tiny

        run_tiny(Path(folder), stages=[*STAGES, {"kind": "diagnose", "rounds": 0}])


if __name__ == "__main__":
    main(sys.argv[1:])
