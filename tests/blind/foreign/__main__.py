"""`python -m tests.blind.foreign`: examine the diagnosis on other machines, forms and plans, and write the table."""

from __future__ import annotations

import argparse
import os
import secrets
import time
from collections.abc import Sequence
from pathlib import Path

from tests.blind.foreign.cases import KINDS, draw_case

USUAL = {"clean": 24, "single": 36, "double": 10, "ordinary": 8, "no_catalogue": 10, "plans": 20}


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    seed = requested.seed if requested.seed is not None else secrets.randbelow(10**8)
    if requested.make is not None:
        return _make(requested.make, seed, requested.out)
    from tests.blind.foreign.examine import examine, keep, kept
    from tests.blind.foreign.judge import judge
    from tests.blind.foreign.table import page, stated

    answers = kept(requested.answers, seed)
    for kind, index in _wanted(requested.classes or KINDS, requested.count):
        if (kind, index) in answers or requested.only_table:
            continue
        answer = examine(draw_case(kind, index, seed), requested.recordings)
        answers[kind, index] = answer
        keep(requested.answers, seed, answer)
        mark = "MISS" if judge(answer).wrong else "ok"
        print(
            f"{mark:<5}{answer.case.label:<16}{answer.cpu_s:5.1f} s  {answer.case.hidden} -> {stated(answer)}",
            flush=True,
        )
    text = page([judge(answer) for answer in answers.values()], seed, time.strftime("%Y-%m-%d"), sum(USUAL.values()))
    if requested.write is not None:
        requested.write.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0


def _wanted(kinds: Sequence[str], count: int | None) -> list[tuple[str, int]]:
    """The cases requested, all classes in turn, so that one that is broken off is balanced."""
    counts = {kind: USUAL[kind] if count is None else count for kind in kinds}
    cases = [(kind, n) for kind in kinds for n in range(counts[kind])]
    return sorted(cases, key=lambda case: case[1] / counts[case[0]])


def _make(label: str, seed: int, out: Path | None) -> int:
    from tests.blind.foreign.record import record

    kind, index = label.split(":")[:2]
    case = draw_case(kind, int(index), seed)
    path = record(case.rig, out if out is not None else Path(label.replace(":", "-")))
    answer = path.with_name(f"{path.name}.answer.txt")
    answer.write_text(f"{case.family}, {case.rig.plan}: {case.hidden}\n", encoding="utf-8")
    print(f"{path}; its answer is in {answer}; fluxbench diagnose {path}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.foreign", description=__doc__)
    parser.add_argument("--seed", type=int, help="random by default; it is in the table")
    parser.add_argument("--count", type=int, help=f"recordings a class; by default {USUAL}")
    parser.add_argument("--classes", nargs="+", choices=KINDS, help="only these")
    parser.add_argument(
        "--answers", type=Path, help="keep the answers there; those that are there are not requested again"
    )
    parser.add_argument("--only-table", action="store_true", help="of the answers that are there; nothing is examined")
    parser.add_argument(
        "--recordings", type=Path, help="keep recordings and truths there; those that are there are read"
    )
    parser.add_argument("--write", type=Path, help="the page to write; without it, it is printed")
    parser.add_argument("--make", metavar="CASE", help="only make this recording, e.g. single:3")
    parser.add_argument("--out", type=Path, help="with --make: the directory")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
