"""Fuzzes the drive protocol, guided by coverage.

    python -m tests.fuzz.fuzz_wire CORPUS -max_total_time=600

needs atheris, which is none of the project's own packages (docs/robustness.md). What is fuzzed is in `targets`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any


def main(words: list[str]) -> None:
    """Fuzz until there is a finding, or one of libFuzzer's limits is reached."""
    try:
        atheris: Any = import_module("atheris")
    except ImportError:
        sys.exit("fuzzing needs atheris: pip install atheris, in an environment of its own")
    with atheris.instrument_imports(include=["plugins.wire"]):
        from tests.fuzz.targets import one_input
    atheris.Setup(words, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv)
