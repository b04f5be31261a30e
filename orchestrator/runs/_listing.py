"""The runs below a folder: what they are of, when they were made, and how they ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from orchestrator.runs._directory import RunDirectory, is_run
from protocols import FluxbenchError


def run_rows(folder: Path, passed_over: Callable[[str], None]) -> Iterator[dict[str, str]]:
    """A row for each run; what cannot be read is told to `passed_over`."""
    for place in sorted(path.parent for path in folder.rglob("run.json")):
        if not is_run(place):
            continue
        try:
            run = RunDirectory.open(place)
            ended = run.ended()
        except FluxbenchError as error:
            passed_over(str(error))
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
