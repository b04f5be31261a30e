"""A fleet's job: a row for each source, nothing twice. The engine decides where the work is done."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.fleet._engine import Done, EngineSettings, Task, work_through
from orchestrator.fleet._progress import JobProgress
from orchestrator.fleet._sources import Source, sources_below
from orchestrator.fleet._table import FleetTable
from orchestrator.fleet._work import Identified, Order, Plan, bare_fields, identify, versions, work_on
from protocols import InputError, Strict
from protocols.fleet import FleetRow

if TYPE_CHECKING:
    from distributed import Client


class FailedSource(Strict):
    """A source without a complete result."""

    source: str
    problem: str


class JobReport(Strict):
    """The result of a job; the JSON contract of `fluxbench fleet run --json`."""

    table: str
    sources: int
    """Number of sources found."""
    known: int
    """Sources that had a row already and were not opened."""
    known_failed: int
    """Known sources without a complete result."""
    same: int
    """Sources with the same content as another one, whose row serves both."""
    new: int
    """Rows written, those of failed sources included."""
    failed: tuple[FailedSource, ...]
    seconds: float


def find_sources(places: Iterable[str], *, files: bool, limit: int | None, tell: Callable[[str], None]) -> list[Source]:
    """Every recording (or measurement file) below folders and URLs, each once.

    Raises
    ------
    InputError
        Where a place cannot be listed, or there is no source at all.
    """
    found: dict[str, Source] = {}
    for place in places:
        # Workers may start in another folder.
        url = place if "://" in place or "::" in place else str(Path(place).resolve())
        for source in sources_below(url, files=files):
            found[source.url] = source
            tell(f"{len(found)} found")
            if limit is not None and len(found) >= limit:
                return list(found.values())
    if not found:
        what = "measurement file" if files else "recording (recording.json or run.json)"
        raise InputError(", ".join(places), "", f"no {what} in or below it")
    return list(found.values())


class FleetJob:
    """A job on many sources: its open tasks, and the rows of their results.

    Parameters
    ----------
    sources : sequence of Source
    table : FleetTable
        It gets a row for each source that has none yet.
    plan : Plan
        The steps for each source.
    tell : callable
        Called with the progress and the remaining time.

    Attributes
    ----------
    todo : list of Source
        Sources without a row, by their listing.
    """

    def __init__(
        self, sources: Sequence[Source], table: FleetTable, plan: Plan, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        self._table, self._plan = table, plan
        self._steps, self._version = _step_names(plan), versions().fluxbench
        visits = [table.visit(s.url, s.fingerprint, self._steps, self._version) for s in sources]
        self.todo = [source for source, visit in zip(sources, visits, strict=True) if visit is None]
        self._known_failed = visits.count("failed")
        self._open, self._found = iter(self.todo), len(sources)
        self._progress = JobProgress(len(self.todo), tell)
        self._orders: deque[tuple[Order, Any]] = deque()
        self._taken: set[str] = set()
        self._count, self._same, self._new = 0, 0, 0
        self._failed: list[FailedSource] = []

    def rows(self, client: Client | None = None, engine: EngineSettings | None = None) -> Iterator[FleetRow]:
        """Run the job; yields each row after it is in the table.

        Parameters
        ----------
        client : distributed.Client, optional
            Its workers run the tasks; without one this process does.

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
        """The report until now."""
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
        """The next task; identified sources go first, because a worker may have fetched them."""
        self._count += 1
        if self._orders:
            order, near = self._orders.popleft()
            return Task(f"work-{self._count}", work_on, (order,), near)
        source = next(self._open, None)
        return None if source is None else Task(f"identify-{self._count}", identify, (source,))

    def _take(self, done: Done) -> FleetRow | None:
        """The row of a result, if it is one."""
        if done.task.work is identify:
            return self._identified(done)
        order: Order = done.task.arguments[0]
        fields = done.result if done.failed is None else {**bare_fields(order), "failed": done.failed}
        return self._add({**fields, "attempts": done.attempts})

    def _identified(self, done: Done) -> FleetRow | None:
        source: Source = done.task.arguments[0]
        identified = done.result or Identified(content_sha256=None, failed=done.failed)
        content = identified.content_sha256 or f"{source.url}\n{source.fingerprint}"
        key = hashlib.sha256(json.dumps([content, self._steps, self._version]).encode()).hexdigest()[:32]
        if key in self._table.keys or key in self._taken:
            self._same += 1
            self._progress.skip()
            return None
        self._taken.add(key)
        order = Order(source=source, key=key, content_sha256=identified.content_sha256, plan=self._plan)
        if identified.failed is not None:
            return self._add({**bare_fields(order), "failed": identified.failed, "attempts": done.attempts})
        self._orders.append((order, done.handle if identified.fetched else None))
        return None

    def _add(self, fields: dict[str, object]) -> FleetRow:
        row = FleetRow.model_validate({**fields, "asked": self._steps})
        self._table.add(row.model_dump())
        self._taken.discard(row.key)
        self._new += 1
        if row.failed is not None:
            self._failed.append(FailedSource(source=row.source, problem=row.failed))
        self._progress.done(row.failed is not None)
        return row


def _step_names(plan: Plan) -> tuple[str, ...]:
    """Names of the steps, with the mapping's hash: all that changes a result."""
    if plan.mapping is None:
        return plan.steps
    return (*plan.steps, f"mapping {hashlib.sha256(plan.mapping.read_bytes()).hexdigest()[:16]}")
