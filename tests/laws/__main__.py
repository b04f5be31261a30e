"""`python -m tests.laws`: hide laws, diagnose, discover, add, and write the table of what was found."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.laws.hidden import KINDS

BEGIN, END = "<!-- laws -->", "<!-- end of laws -->"
"""Between these lines of the page the table stands."""


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from protocols import FluxbenchError
    from tests.laws.examine import examine, keep, kept
    from tests.laws.score import judge, table

    answers = kept(requested.answers, requested.seed) if requested.answers is not None else {}
    with tempfile.TemporaryDirectory(prefix="laws-") as temporary:
        folder = requested.recordings or Path(temporary)
        for kind in requested.only or KINDS:
            if kind in answers:
                continue
            try:
                answers[kind] = answer = examine(kind, requested.seed, folder)
            except FluxbenchError as error:
                print(f"{'MISS':<5}{kind:<20}refused: {error}", flush=True)
                continue
            if requested.answers is not None:
                keep(requested.answers, answer)
            mark = "ok" if judge(answer).is_right else "MISS"
            print(f"{mark:<5}{kind:<20}{answer.after:8.3g}  {answer.places} {answer.formulas}", flush=True)
    text = table([judge(answers[kind]) for kind in KINDS if kind in answers], requested.seed)
    if requested.write is None:
        print(text)
    else:
        _replace(requested.write, text)
    return 0


def _replace(page: Path, text: str) -> None:
    before, rest = page.read_text(encoding="utf-8").split(BEGIN, 1)
    page.write_text(f"{before}{BEGIN}\n{text}{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.laws", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--only", nargs="+", choices=list(KINDS), metavar="K", help="only these kinds")
    parser.add_argument("--answers", type=Path, help="keep the answers there; those that are there are not repeated")
    parser.add_argument("--recordings", type=Path, help="keep the recordings there")
    parser.add_argument("--write", type=Path, help=f"the page whose table, after {BEGIN}, is replaced")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
