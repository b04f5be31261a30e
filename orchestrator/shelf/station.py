"""A station's work: one motor after the other by serial number, each with a label line and an exit code."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orchestrator.formatting.quantities import UNKNOWN
from orchestrator.runs import RunDirectory
from orchestrator.shelf.acceptance import SYMBOLS, judge_acceptance
from orchestrator.shelf.facts import QUANTITIES, RunFacts, cells, read_facts
from orchestrator.shelf.results import load_results
from protocols import AcceptanceResult, FluxbenchError

NOT_ACCEPTED = 4
"""Exit code of a run whose motor does not keep its limits."""
MAX_NAME_LENGTH = 60


@dataclass(frozen=True)
class JudgedRun:
    """A run with the judgement by its procedure's limits; None where it has none, or the run has not finished."""

    folder: Path
    facts: RunFacts
    acceptance: AcceptanceResult | None

    @property
    def exit_code(self) -> int:
        """0, or `NOT_ACCEPTED`."""
        return NOT_ACCEPTED if self.acceptance is not None and not self.acceptance.passed else 0

    @property
    def label(self) -> str:
        """A line for the shelf: serial number, PASS or FAIL, what was measured, the run."""
        facts = self.facts
        outcome = facts.outcome if self.acceptance is None else "PASS" if self.acceptance.passed else "FAIL"
        values = [
            f"{SYMBOLS[name]} {text}"
            for name, text in zip(QUANTITIES, cells(facts, QUANTITIES), strict=True)
            if text != UNKNOWN
        ]
        parts = (facts.serial or "no serial number", outcome, facts.motor, *values, facts.created, self.folder.name)
        return "  ".join(part for part in parts if part)


def judge_run(folder: Path) -> JudgedRun:
    """The judgement of a run; raises `RecordingError` where its record, journal or results are damaged."""
    facts = read_facts(folder, folder.name)
    procedure = RunDirectory.open(folder).record.procedure
    if procedure.accept is None or facts.outcome != "finished":
        return JudgedRun(folder, facts, None)
    results = load_results(folder, procedure.motor.rated_current_a)
    return JudgedRun(folder, facts, judge_acceptance(procedure.accept, results))


def run_folder_of(procedure: str, serial: str) -> Path:
    """A new folder below ``runs/`` for a motor, with its serial number in the name."""
    name = re.sub(r"[^A-Za-z0-9._]+", "-", serial).strip("-.")[:MAX_NAME_LENGTH]
    return Path("runs") / "-".join(part for part in (procedure, name, time.strftime("%Y%m%d-%H%M%S")) if part)


def ask_serial() -> str:
    """The next motor's serial number, from a terminal or scanner on standard input; empty at the end."""
    print("serial number of the next motor (empty: end): ", end="", flush=True)
    line = sys.stdin.readline()
    if not line.endswith("\n"):
        print()
    return " ".join(line.split())


def work_through(ask: Callable[[], str], run_motor: Callable[[str], int], complain: Callable[[str], None]) -> int:
    """Run motors until no serial number is given; returns the exit code of the worst.

    Parameters
    ----------
    ask : callable
        Asks for the next serial number; an empty text ends.
    run_motor : callable
        Runs the motor with this serial number, and returns an exit code.
    complain : callable
        Reports the error of a run that ended in a fault; the next motor follows.

    Raises
    ------
    FluxbenchError
        Whatever would end every further run too: wrong input, an interruption.
    """
    codes = [0]
    while serial := ask():
        try:
            codes.append(run_motor(serial))
        except FluxbenchError as error:
            if error.exit_code != 3:
                raise
            complain(str(error))
            codes.append(error.exit_code)
        if codes[-1] not in (0, 3, NOT_ACCEPTED):
            return codes[-1]
    return 3 if 3 in codes else max(codes)
