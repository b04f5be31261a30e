"""`python -m tests.laws`: hide laws, diagnose, discover, add, and write the table of what was found."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.blind.effects import FOREIGN
from tests.laws.hidden import KINDS

BLIND = [f"{kind}:{k}" for k in range(len(FOREIGN)) for kind in ("foreign", "left_out", "foreign_behind")]
"""The blind suite's recordings that no effect of the library explains, one of each kind."""
SUITES = {"laws": list(KINDS), "blind": BLIND}


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from protocols import FluxbenchError
    from tests.laws.examine import examine, keep, kept, recording_in, with_baseline
    from tests.laws.score import judge, table

    labels = requested.only or SUITES[requested.suite]
    answers = kept(requested.answers, requested.seed) if requested.answers is not None else {}
    with tempfile.TemporaryDirectory(prefix="laws-") as temporary:
        folder = requested.recordings or Path(temporary)
        for label in [] if requested.table else labels:
            answer = answers.get(label)
            try:
                answer = answer or examine(label, requested.seed, folder)
                if requested.baseline and not answer.baseline and recording_in(folder, label).exists():
                    answer = with_baseline(answer, folder)
            except FluxbenchError as error:
                print(f"{'MISS':<5}{label:<20}refused: {error}", flush=True)
                continue
            if answer == answers.get(label):
                continue
            answers[label] = answer
            if requested.answers is not None:
                keep(requested.answers, answer)
            mark = "ok" if judge(answer).is_right else "MISS"
            print(f"{mark:<5}{label:<20}{answer.after:8.3g}  {answer.places} {answer.formulas}", flush=True)
    text = table([judge(answers[label]) for label in labels if label in answers], requested.seed)
    if requested.write is None:
        print(text)
    else:
        _replace(requested.write, requested.suite, text)
    return 0


def _replace(page: Path, suite: str, text: str) -> None:
    """Put a table between the two comments of its suite."""
    begin, end = f"<!-- {suite} -->", f"<!-- end of {suite} -->"
    before, rest = page.read_text(encoding="utf-8").split(begin, 1)
    page.write_text(f"{before}{begin}\n{text}{end}{rest.split(end, 1)[1]}", encoding="utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.laws", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--only", nargs="+", metavar="LABEL", help="only these, as poor_contact or foreign:3")
    parser.add_argument(
        "--suite", choices=list(SUITES), default="laws", help="laws of this plant, or the blind suite's"
    )
    parser.add_argument("--table", action="store_true", help="examine nothing: the table of the kept answers")
    parser.add_argument("--baseline", action="store_true", help="thresholded least squares beside each answer, too")
    parser.add_argument("--answers", type=Path, help="keep the answers there; those that are there are not repeated")
    parser.add_argument("--recordings", type=Path, help="keep the recordings there")
    parser.add_argument("--write", type=Path, help="the page whose table of the suite is replaced")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
