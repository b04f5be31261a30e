"""`python -m tests.torture`: every attack many times, from where the last call left off, and the table of what came."""

from __future__ import annotations

import argparse
import json
import os
import random
import secrets
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.torture.attacks import ATTACKS, Attack

HEADING = "## Tortured"
Kept = dict[str, Any]
"""One attempt: attack, k, outcome, finding (empty where there was none), seconds."""


def main(words: Sequence[str] | None = None) -> int:
    """Entry point: 0 where nothing was found, 1 where something was."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    log: Path = requested.log
    log.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()] if log.exists() else []
    seed = kept[0]["seed"] if kept else requested.seed if requested.seed is not None else secrets.randbelow(10**8)
    chosen = [attack for attack in ATTACKS if not requested.only or attack.name in requested.only]
    for attack in chosen:
        times = max(1, round(requested.part * attack.usual))
        done = {one["k"] for one in kept if one["attack"] == attack.name}
        left = [k for k in range(times) if k not in done]
        for one in attempts(attack, seed, left, 60.0 * requested.minutes / len(chosen)):
            kept.append(one)
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(one) + "\n")
            if one["finding"]:
                print(f"{attack.name} {one['k']} (seed {seed}): {one['finding']}", file=sys.stderr, flush=True)
        print(f"{attack.name}: {told_of([one for one in kept if one['attack'] == attack.name])}", flush=True)
    if requested.write is not None:
        text = requested.write.read_text(encoding="utf-8").split(HEADING)[0].rstrip()
        requested.write.write_text(f"{text}\n\n{section(kept, seed)}", encoding="utf-8")
    return int(any(one["finding"] for one in kept))


def attempts(attack: Attack, seed: int, which: Sequence[int], seconds: float) -> Iterator[Kept]:
    """Make an attack so often, until the time is over; each is drawn from the seed and its number alone."""
    over_s = time.monotonic() + seconds
    for k in which:
        begun_s = time.monotonic()
        if begun_s > over_s:
            return
        outcome = finding = ""
        with tempfile.TemporaryDirectory(prefix="torture-", ignore_cleanup_errors=True) as folder:
            try:
                outcome = attack.once(random.Random(f"{seed}/{attack.name}/{k}"), Path(folder))
            except Exception as error:  # whatever came out is what was looked for
                where = traceback.extract_tb(error.__traceback__)[-1]
                finding = f"{type(error).__name__} in {where.name}: {str(error)[:400]}"
        took_s = round(time.monotonic() - begun_s, 2)
        yield {
            "attack": attack.name, "k": k, "seed": seed, "outcome": outcome, "finding": finding, "seconds": took_s
        }  # fmt: skip


def told_of(kept: Sequence[Kept]) -> str:
    """How often, what came of it, and how many findings."""
    outcomes = Counter(one["outcome"] for one in kept if one["outcome"])
    came = ", ".join(f"{outcome} {count}" for outcome, count in outcomes.most_common())
    return f"{len(kept)} times; {came}; {sum(bool(one['finding']) for one in kept)} findings"


def section(kept: Sequence[Kept], seed: int) -> str:
    """The part of the page that holds the table."""
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    day = time.strftime("%Y-%m-%d", time.gmtime())
    rows = []
    for attack in ATTACKS:
        mine = [one for one in kept if one["attack"] == attack.name]
        times, _, rest = told_of(mine).partition(" times; ")
        came, _, findings = rest.rpartition("; ")
        minutes = sum(one["seconds"] for one in mine) / 60.0
        count = findings.split()[0] if mine else "0"
        rows.append(
            f"| {attack.name} | {times} of {attack.usual} | {attack.reported} | {came} | {minutes:.0f} | {count} |"
        )
    return f"""{HEADING}

    make torture

makes the attacks of `tests/torture` from a seed, continues where it ended (`runs/torture.jsonl`), and stops after
`MINUTES` minutes, 300 by default; all of it takes longer. Each attempt is drawn from the seed and its own number, so
that it can be repeated. A small part is in `make test`.

{day}, seed {seed}, commit {commit.stdout.strip()}, beside other work on {os.cpu_count()} cores:

| attack | times | what must hold | what came | minutes | findings |
| --- | --- | --- | --- | --- | --- |
{chr(10).join(rows)}
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    parser.add_argument(
        "--seed", type=int, help="by default one that nobody chose; a log that is gone on with keeps its own"
    )
    parser.add_argument("--minutes", type=float, default=300.0, help="for all attacks together")
    parser.add_argument("--part", type=float, default=1.0, help="of the usual counts")
    parser.add_argument("--only", nargs="*", choices=[attack.name for attack in ATTACKS])
    parser.add_argument("--log", type=Path, default=Path("runs/torture.jsonl"))
    parser.add_argument("--write", type=Path, help="the page whose last section becomes the table")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
