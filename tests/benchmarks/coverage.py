"""How often stated intervals hold the truth: `python -m tests.benchmarks.coverage [runs of each kind]`."""

from __future__ import annotations

import sys

from tests.support.coverage import SCENARIOS, cover, together

RUNS = 8


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    print("share of nodes, in per cent, whose 95 % interval holds the truth (stated standard deviation over rms error)")
    found = {}
    for name in SCENARIOS:
        found[name] = cover(name, runs)
        print(f"{name}: {found[name]}", flush=True)
    print(f"all: {together(found.values())}")


if __name__ == "__main__":
    main()
