"""`python -m tests.blind.benchmark.page`: write the figures of docs/benchmark.md from files of answers.

python -m tests.blind.benchmark.page set/truth fluxbench=a.jsonl LASSO=b.jsonl --write docs/benchmark.md
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.benchmark import scorer

START, END = "<!-- figures -->\n", "<!-- end of figures -->"
BY_METHOD = (
    "plants", "right", "verdict", "main name", "exact set", "false names", "sizes inside", "R_s error, %",
    "map error, %", "usable", "though off", "s",
)  # fmt: skip
"""Of the scorer's columns, those that compare methods."""


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.benchmark.page", description=__doc__)
    parser.add_argument("truth", type=Path)
    parser.add_argument("answers", nargs="+", help="NAME=FILE, fluxbench first", metavar="NAME=FILE")
    parser.add_argument("--write", type=Path, required=True, help="the page")
    wanted = parser.parse_args(words)
    files = dict(one.split("=", 1) for one in wanted.answers)
    scores = {name: scorer.scores_of(Path(file), wanted.truth) for name, file in files.items()}
    text = wanted.write.read_text(encoding="utf-8")
    before, rest = text.split(START)
    after = rest.split(END)[1]
    wanted.write.write_text(before + START + figures(scores) + END + after, encoding="utf-8")
    return 0


def figures(scores: Mapping[str, Sequence[scorer.Score]]) -> str:
    """The tables, of the recordings that all of the methods have answered."""
    every = list(scores.values())
    common = {s["id"] for s in every[0] if all(t["answered"] for one in every for t in one if t["id"] == s["id"])}
    chosen = {name: [s for s in one if s["id"] in common] for name, one in scores.items()}
    first, ours = next(iter(chosen.items()))
    at = [scorer.HEAD.index(name) for name in BY_METHOD]
    compared = [
        (name, *(row[k] for k in at)) for name, one in chosen.items() for row in scorer.rows_of(one) if row[0] == "all"
    ]
    worst = [
        (s["id"], f"{s['class']}, {s['origin']}", s["motor"], s["hidden"], s["stated"], scorer.missed(s))
        for s in scorer.worst(ours)
    ]
    return "\n".join(
        [
            "",
            f"{time.strftime('%Y-%m-%d')}, {len(common)} of {len(every[0])} recordings; medians of errors and seconds.",
            "",
            *_table(("method", *BY_METHOD), compared),
            "",
            f"{first} by class:",
            "",
            *_table(scorer.HEAD, scorer.rows_of(ours)),
            "",
            f"The answers of {first} that are furthest from right:",
            "",
            *_table(("recording", "class", "motor", "hidden", "stated", "missed"), worst),
            "",
            "",
        ]
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(map(str, row)) + " |" for row in lines]


if __name__ == "__main__":
    raise SystemExit(main())
