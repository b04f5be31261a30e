"""`python -m tests.blind`: examine the diagnosis on recordings with hidden effects, and write the table."""

from __future__ import annotations

import argparse
import os
import secrets
import time
from collections.abc import Sequence
from pathlib import Path

from tests.blind.hidden import KINDS, draw_case

USUAL = {
    "clean": 40,
    "single": 54,
    "double": 20,
    "clutter": 18,
    "ordinary": 18,
    "left_out": 18,
    "foreign": 18,
    "nuisance": 26,
    "faint": 36,
    "foreign_behind": 18,
    "switched_clean": 12,
    "switched": 18,
    "switched_foreign": 6,
}


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    seed = requested.seed if requested.seed is not None else secrets.randbelow(10**8)
    if requested.make is not None:
        return _make(requested.make, seed, requested.out)
    from tests.blind.examine import examine_all, keep, kept
    from tests.blind.score import judge, stated
    from tests.blind.table import page

    answers = kept(requested.answers, seed)
    if requested.recordings is not None:
        requested.recordings.mkdir(parents=True, exist_ok=True)
    wanted = _wanted(requested.classes or KINDS, requested.count, requested.first)
    todo = [case for case in wanted if case not in answers]
    for answer in examine_all(todo, seed, requested.jobs, requested.recordings):
        answers[answer.case.kind, answer.case.index] = answer
        keep(requested.answers, seed, answer)
        mark = "MISS" if judge(answer).wrong else "ok"
        print(
            f"{mark:<5}{answer.case.label:<34}{answer.cpu_s:5.1f} s  {answer.case.hidden} -> {stated(answer)}",
            flush=True,
        )
    text = page([judge(answer) for answer in answers.values()], seed, time.strftime("%Y-%m-%d"), sum(USUAL.values()))
    if requested.write is not None:
        requested.write.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


def _wanted(kinds: Sequence[str], count: int | None, first: int) -> list[tuple[str, int]]:
    """The cases requested, all classes in turn, so that one that is broken off is balanced."""
    counts = {kind: USUAL[kind] if count is None else count for kind in kinds}
    cases = [(kind, first + n) for kind in kinds for n in range(counts[kind])]
    return sorted(cases, key=lambda case: (case[1] - first) / counts[case[0]])


def _make(label: str, seed: int, out: Path | None) -> int:
    from tests.blind.campaign import record

    kind, index = label.split(":")[:2]
    case = draw_case(kind, int(index), seed)
    path = record(case.bench, case.campaign, out if out is not None else Path(label.replace(":", "-")))
    without = "".join(f" --without {name}" for name in case.without)
    answer = path.with_name(f"{path.name}.answer.txt")
    answer.write_text(f"{case.hidden}\n", encoding="utf-8")
    print(f"{path}; its answer is in {answer}; fluxbench diagnose {path}{without}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("--seed", type=int, help="by default one that nobody chose; it stands in the table")
    parser.add_argument("--count", type=int, help=f"recordings a class; by default {USUAL}")
    parser.add_argument("--first", type=int, default=0, help="index of the first recording of each class")
    parser.add_argument("--classes", nargs="+", choices=KINDS, help="only these")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--answers", type=Path, help="keep the answers there; those that are there are not requested again"
    )
    parser.add_argument("--recordings", type=Path, help="keep the recordings there; those that are there are read")
    parser.add_argument("--write", type=Path, help="the page to write; without it, it is printed")
    parser.add_argument("--make", metavar="CASE", help="only make this recording, e.g. single:3")
    parser.add_argument("--out", type=Path, help="with --make: the directory")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
