"""The page's shelf: runs listed and searched, compared, followed over time, labelled and opened in the viewer.

Whatever reads a run's results is a process of its own: neither a damaged file nor ten thousand runs may hold up an
active run, or the button that stops it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from orchestrator.formatting.sentences import shown
from orchestrator.runs import RunDirectory
from orchestrator.shelf import (
    COLUMNS,
    QUANTITIES,
    Condition,
    FoundRuns,
    RunFacts,
    RunQuery,
    cells,
    count_stale,
    find_runs,
    interval_columns,
    load_labels,
    save_labels,
)
from plugins.commands.serve._choices import REPORT, RUNS, run_folder
from plugins.commands.serve._run import Checks, NotNowError
from plugins.commands.serve._wanted import ComparedRuns, RunLabelled, RunNamed, RunsWanted, Trend
from protocols import InputError, RunLabels

NEWEST = 30
"""Runs on the first page."""
ROWS = 100
"""Runs that one answer has."""
MAX_TREND = 1000
_DIRECTLY = Condition("run", "!~", "/")
"""The runs of the folder itself, which alone have addresses."""
_PRINTED = (*QUANTITIES, "map_error_percent", "duration_s")
_TEXTS = (
    "run", "created", "procedure", "motor", "outcome", "serial", "operator", "tags", "notes", "drive", "verdict",
    "causes", "accepted", "objections",
)  # fmt: skip


class Shelf:
    """The runs of the served folder.

    Parameters
    ----------
    folder : Path
        The served folder.
    checks : Checks
        Starts the processes.
    """

    def __init__(self, folder: Path, checks: Checks) -> None:
        self._folder, self._runs, self._checks = folder, folder / RUNS, checks
        self._indexing = asyncio.Lock()

    async def newest(self) -> dict[str, Any]:
        """The newest runs, and the errors of those that cannot be read."""
        found = await self._find(RunQuery(conditions=[_DIRECTLY], sort="-created", limit=NEWEST))
        problems = [shown(problem) for problem in found.problems[:NEWEST]]
        return {"runs": [self._row(row) for row in found.rows], "unreadable": problems}

    async def listed(self, wanted: RunsWanted) -> dict[str, Any]:
        """Some of the runs that are wanted, and how many there are."""
        query = RunQuery(wanted.words.split(), [_DIRECTLY], wanted.sort, ROWS, wanted.skip)
        query.order  # noqa: B018  # a wrong column is refused before any process is started
        found = await self._find(query)
        problems = [shown(problem) for problem in found.problems[:NEWEST]]
        return {"rows": [self._row(row) for row in found.rows], "count": found.count, "unreadable": problems}

    async def trend(self, wanted: Trend) -> dict[str, Any]:
        """R_s and rated flux with their intervals over the runs of one motor, the oldest first."""
        conditions = [_DIRECTLY, Condition("motor", "=", wanted.motor), Condition("serial", "=", wanted.serial)]
        found = await self._find(RunQuery(conditions=conditions, sort="-created", limit=MAX_TREND))
        points = [_point(dict(zip(COLUMNS, row, strict=True))) for row in reversed(found.rows)]
        return {"motor": shown(wanted.motor), "serial": shown(wanted.serial), "points": points}

    async def compared(self, wanted: ComparedRuns) -> dict[str, Any]:
        """Tables and curves of a comparison of runs; raises `InputError`."""
        folders = [str(run_folder(self._folder, run)) for run in wanted.runs]
        code, out, err = await self._checks.run(["compare", "--json", "--", *folders])
        if code:
            raise InputError("compare", "", err.removeprefix("fluxbench: ") or f"ended with {code}")
        return await run_in_threadpool(_comparison, out)

    def labels(self, named: RunNamed) -> dict[str, Any]:
        """A run's tags and notes; raises `RecordingError`."""
        place = run_folder(self._folder, named.run)
        return load_labels(place, RunDirectory.open(place).record.procedure.about).model_dump(include={"tags", "notes"})

    def label(self, wanted: RunLabelled) -> None:
        """Replace a run's tags and notes."""
        save_labels(run_folder(self._folder, wanted.run), RunLabels(tags=wanted.tags, notes=wanted.notes))

    async def _find(self, query: RunQuery) -> FoundRuns:
        if not self._runs.is_dir():
            return FoundRuns([], 0, [])
        async with self._indexing:
            if await run_in_threadpool(count_stale, self._runs):
                refresh = ["runs", "--folder", str(self._runs), "--limit", "1", "--skip-damaged"]
                with suppress(NotNowError):  # too many processes, or too many runs for one: what is known is shown
                    await self._checks.run(refresh)
            return await run_in_threadpool(partial(find_runs, self._runs, query, refreshed=False))

    def _row(self, values: Sequence[Any]) -> dict[str, Any]:
        facts = RunFacts(*values)
        row = {name: shown(getattr(facts, name)) for name in _TEXTS}
        row |= dict(zip(_PRINTED, cells(facts, _PRINTED), strict=True))
        return row | {"has_report": (self._runs / facts.run / REPORT).is_file()}


def _point(row: dict[str, Any]) -> dict[str, Any]:
    point = {"run": shown(row["run"]), "created": row["created"]}
    for name in ("resistance_ohm", "rated_flux_wb"):
        low, high = interval_columns(name)
        point[name] = None if row[name] is None else [row[name], row[low], row[high]]
    return point


def _comparison(text: str) -> dict[str, Any]:
    # Its imports take a second, which most servers never need.
    from orchestrator.interface.comparison import RunsComparison, change_rows, run_rows

    comparison = RunsComparison.model_validate_json(text)
    tables = [run_rows(comparison), change_rows(comparison)]
    return {
        "names": [shown(run.name) for run in comparison.runs],
        "tables": [[[shown(cell) for cell in row] for row in rows] for rows in tables],
        "curves": [curve.model_dump() for curve in comparison.curves],
        "remarks": [shown(remark.text) for remark in comparison.remarks],
    }
