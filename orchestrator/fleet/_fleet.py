"""A fleet's job: sources in, rows out, nothing done twice. Where and how the work is done is the engine's business."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.fleet._engine import Done, EngineSettings, Task, work_through
from orchestrator.fleet._progress import Progress
from orchestrator.fleet._sources import Source, sources_below
from orchestrator.fleet._table import FleetTable
from orchestrator.fleet._work import Identified, Order, Plan, bare_fields, identify, versions, work_on
from protocols import InputError, Strict
from protocols.fleet import FleetRow

if TYPE_CHECKING:
    from distributed import Client


class FailedSource(Strict):
    """A source without a result, or without all of it."""

    source: str
    problem: str


class JobReport(Strict):
    """What a job did; the JSON contract of `fluxbench fleet run --json`."""

    table: str
    sources: int
    """That were found."""
    known: int
    """Of them, those that had a row already and were not opened."""
    known_failed: int
    """Of those, how many have no result, or not all of it."""
    same: int
    """Of them, those with the content of another, whose row stands for both."""
    new: int
    """Rows that were written, with those of what failed."""
    failed: tuple[FailedSource, ...]
    seconds: float


def find_sources(places: Iterable[str], *, files: bool, limit: int | None, tell: Callable[[str], None]) -> list[Source]:
    """Every recording (or measurement file) below folders and URLs, each once.

    Raises
    ------
    InputError
        Where one cannot be listed, or there is none at all.
    """
    found: dict[str, Source] = {}
    for place in places:
        for source in sources_below(_absolute(place), files=files):
            found[source.url] = source
            tell(f"{len(found)} found")
            if limit is not None and len(found) >= limit:
                return list(found.values())
    if not found:
        what = "measurement file" if files else "recording (recording.json or run.json)"
        raise InputError(", ".join(places), "", f"no {what} in or below it")
    return list(found.values())


def _absolute(place: str) -> str:
    """Workers may be started elsewhere."""
    return place if "://" in place or "::" in place else str(Path(place).resolve())


class FleetJob:
    """A job on many sources: what is still to be asked, and what becomes of the answers.

    Parameters
    ----------
    sources : sequence of Source
    table : FleetTable
        That gets a row for each source that has none yet.
    plan : Plan
        What is done with each.
    tell : callable
        Called with how far it is and how long it takes yet.

    Attributes
    ----------
    todo : list of Source
        Those without a row, as far as their listing tells.
    """

    def __init__(
        self, sources: Sequence[Source], table: FleetTable, plan: Plan, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        self._table, self._plan = table, plan
        self._asked, self._version = _question(plan), versions().fluxbench
        visits = [table.visit(s.url, s.fingerprint, self._asked, self._version) for s in sources]
        self.todo = [source for source, visit in zip(sources, visits, strict=True) if visit is None]
        self._known_failed = visits.count("failed")
        self._left, self._found = iter(self.todo), len(sources)
        self._progress = Progress(len(self.todo), tell)
        self._orders: deque[tuple[Order, Any]] = deque()
        self._taken: set[str] = set()
        self._count, self._same, self._new = 0, 0, 0
        self._failed: list[FailedSource] = []

    def rows(self, client: Client | None = None, engine: EngineSettings | None = None) -> Iterator[FleetRow]:
        """Do it; each row is handed out when the table has it.

        Parameters
        ----------
        client : distributed.Client, optional
            Whose workers do it; without one it is done here.

        Raises
        ------
        StorageError
            Where the table cannot be written, or the scheduler is gone.
        """
        with closing(work_through(self._next_task, client, engine)) as answers:
            for done in answers:
                row = self._take(done)
                if row is not None:
                    yield row

    def report(self, table: Path, seconds: float) -> JobReport:
        """What was done until now."""
        return JobReport(
            table=str(table),
            sources=self._found,
            known=self._found - len(self.todo),
            known_failed=self._known_failed,
            same=self._same,
            new=self._new,
            failed=tuple(self._failed),
            seconds=seconds,
        )

    def _next_task(self) -> Task | None:
        """What was identified goes first: a worker may have it at hand."""
        self._count += 1
        if self._orders:
            order, beside = self._orders.popleft()
            return Task(f"work-{self._count}", work_on, (order,), beside)
        source = next(self._left, None)
        return None if source is None else Task(f"identify-{self._count}", identify, (source,))

    def _take(self, done: Done) -> FleetRow | None:
        """A row, where the answer is one."""
        if done.task.work is identify:
            return self._identified(done)
        order: Order = done.task.arguments[0]
        fields = done.result if done.failed is None else {**bare_fields(order), "failed": done.failed}
        return self._added({**fields, "attempts": done.attempts})

    def _identified(self, done: Done) -> FleetRow | None:
        source: Source = done.task.arguments[0]
        told = done.result or Identified(content_sha256=None, failed=done.failed)
        key = self._key(told.content_sha256 or f"{source.url}\n{source.fingerprint}")
        if key in self._table.keys or key in self._taken:
            self._same += 1
            self._progress.passed_over()
            return None
        self._taken.add(key)
        order = Order(source=source, key=key, content_sha256=told.content_sha256, plan=self._plan)
        if told.failed is not None:
            return self._added({**bare_fields(order), "failed": told.failed, "attempts": done.attempts})
        self._orders.append((order, done.handle if told.fetched else None))
        return None

    def _added(self, fields: dict[str, object]) -> FleetRow:
        row = FleetRow.model_validate({**fields, "asked": self._asked})
        self._table.add(row.model_dump())
        self._taken.discard(row.key)
        self._new += 1
        if row.failed is not None:
            self._failed.append(FailedSource(source=row.source, problem=row.failed))
        self._progress.done(row.failed is not None)
        return row

    def _key(self, content: str) -> str:
        return hashlib.sha256(json.dumps([content, self._asked, self._version]).encode()).hexdigest()[:32]


def _question(plan: Plan) -> tuple[str, ...]:
    """What was asked for, as far as it makes another result."""
    if plan.mapping is None:
        return plan.steps
    return (*plan.steps, f"mapping {hashlib.sha256(plan.mapping.read_bytes()).hexdigest()[:16]}")
