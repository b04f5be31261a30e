"""The runs below a folder, with their motors, times and outcomes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from orchestrator.runs._directory import RunDirectory, is_run
from protocols import FluxbenchError


def run_rows(folder: Path, report_error: Callable[[str], None]) -> Iterator[dict[str, str]]:
    """A row for each run; `report_error` is called with the error of an unreadable one."""
    for place in sorted(path.parent for path in folder.rglob("run.json")):
        if not is_run(place):
            continue
        try:
            run = RunDirectory.open(place)
            ended = run.ended()
        except FluxbenchError as error:
            report_error(str(error))
            continue
        procedure = run.record.procedure
        yield {
            "run": str(place),
            "created": run.record.created,
            "procedure": procedure.name,
            "motor": procedure.motor.name,
            "outcome": "not ended" if ended is None else ended.outcome,
            **dict.fromkeys(("serial", "operator", "tags", "notes"), ""),
            **dict(procedure.about.lines()),
        }
