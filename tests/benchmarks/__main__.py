"""Runs every benchmark in this folder, one after the other."""

from __future__ import annotations

import importlib
from pathlib import Path


def main() -> None:
    for file in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        if file.stem.startswith("test_"):
            continue
        print(f"-- {file.stem}")
        importlib.import_module(f"tests.benchmarks.{file.stem}").main()


if __name__ == "__main__":
    main()
