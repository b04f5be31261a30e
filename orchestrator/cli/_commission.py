"""`fluxbench run` and `fluxbench resume`: from words to a crew, and from a result to an exit code."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

from orchestrator.config import load_procedure
from orchestrator.engine import (
    AbsentOperator,
    Crew,
    Operator,
    RunResult,
    TerminalOperator,
    handling_signals,
    resume_run,
    start_run,
)
from protocols import FluxbenchError


def run(
    source: str,
    drive: str | None,
    motor: Path | None,
    overrides: Sequence[str],
    out: Path | None,
    unattended: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Commission into a new directory; returns the exit code."""
    procedure = load_procedure(source, overrides=overrides, drive=drive, motor=motor)
    path = out if out is not None else Path("runs") / f"{procedure.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    return _with_crew(lambda crew: start_run(procedure, path, crew), unattended, quiet, as_json)


def resume(path: Path, unattended: bool, quiet: bool, as_json: bool) -> int:
    """Go on with an interrupted run; energises only on the operator's word."""
    return _with_crew(lambda crew: resume_run(path, crew), unattended, quiet, as_json)


def _with_crew(commission: Callable[[Crew], RunResult], unattended: bool, quiet: bool, as_json: bool) -> int:
    operator: Operator = AbsentOperator() if unattended or not sys.stdin.isatty() else TerminalOperator()
    mode = "quiet" if quiet or as_json else "auto"
    streams: dict[str, dict[str, Any]] = {"console": {"mode": mode}, "report": {}}
    with handling_signals() as interrupts:
        result = commission(Crew(operator, interrupts, streams))
    for tally in result.streams:
        if tally.dropped or tally.errors or not tally.closed:
            _warn(
                f"stream {tally.name}: {tally.delivered} delivered, {tally.dropped} dropped, {tally.errors} errors"
                + (f" (first: {tally.first_error})" if tally.first_error else "")
            )
    report = result.path / "report.html"
    if mode == "auto" and report.is_file():
        _tell(f"report: {report}", sys.stdout)
    return _exit_code(result, as_json)


def _exit_code(result: RunResult, as_json: bool) -> int:
    outcome = result.outcome
    if as_json:
        import json

        found = {"run": str(result.path), "outcome": outcome.ending, "reason": outcome.reason}
        print(json.dumps(found | {"estimates": dict(outcome.estimates)}, indent=2))
    if outcome.error is None:
        return 0
    if not isinstance(outcome.error, FluxbenchError):
        raise outcome.error  # a defect: its traceback is wanted, now that the drive is safe
    _warn(f"{outcome.ending}: {outcome.reason}; `fluxbench resume {result.path}` goes on at the first point not done")
    return max(outcome.error.exit_code, 3)


def _warn(line: str) -> None:
    _tell(f"fluxbench: {' '.join(line.split())}", sys.stderr)


def _tell(line: str, where: TextIO) -> None:
    try:
        print(line, file=where)
    except OSError:  # the terminal is gone, and with it the reader
        return
