"""`python -m tests.motor_time RUNS [--bench WORDS] [--plans demo,quick]`: error over motor time, of docs/adaptive.md.

Runs stay in the folder RUNS, and are read when they are there already, so that a call may be stopped and go on, or do
one bench at a time. Prints the tables of all benches that are there, and draws docs/pictures/motor-time.png. Twenty
minutes of one core for all.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.motor_time.measuring import BENCHES, PLANS, measured
from tests.motor_time.picture import course, draw, table

PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "motor-time.png"


def main(words: list[str]) -> int:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(prog="python -m tests.motor_time", description=__doc__)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--bench", choices=[bench.words for bench in BENCHES], action="append")
    parser.add_argument("--plans", type=lambda text: tuple(text.split(",")), default=PLANS)
    requested = parser.parse_args(words)
    found = {}
    for bench in BENCHES:
        if requested.bench and bench.words not in requested.bench:
            continue
        found[bench.words] = list(measured(bench, requested.runs / bench.words.replace(", ", "-"), requested.plans))
        print(
            f"{table({bench.words: found[bench.words]})}\n\n{course({bench.words: found[bench.words]})}\n", flush=True
        )
    draw(found, PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
