"""Compiles the kernels once, into their caches: two workers of the tests that begin together would both do it.

A small run with a diagnosis calls nearly all of them. `make test` runs this where a kernel's source has changed.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.support.tiny import STAGES, run_tiny


def main() -> None:
    """Run the tiny procedure with a diagnosis at its end."""
    with tempfile.TemporaryDirectory() as folder:
        run_tiny(Path(folder), stages=[*STAGES, {"kind": "diagnose", "rounds": 0}])


if __name__ == "__main__":
    main()
