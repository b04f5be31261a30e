"""A campaign's execution: simulate motors, analyse their recordings, and store the truth with the results.

The analysis of a recording is a task of its own; the truth stays with the client until its result has arrived.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.fleet import (
    Done,
    FleetTable,
    JobProgress,
    Order,
    Plan,
    Source,
    Task,
    bare_fields,
    versions,
    work_on,
    work_through,
)
from orchestrator.fleet.campaign._plan import Run
from protocols import Procedure
from protocols.fleet import FleetRow

if TYPE_CHECKING:
    from distributed import Client

    from orchestrator.fleet import EngineSettings


def simulate(procedure: dict[str, Any], place: str) -> None:
    """Run a procedure on its simulated drive into a new directory, and remove the truth from it."""
    from orchestrator.interface.api import run
    from orchestrator.runs import private_directory

    out = Path(place)
    for old in (out, private_directory(out)):  # left by a worker that died
        shutil.rmtree(old, ignore_errors=True)
    run(Procedure.model_validate(procedure), out=out, streams=())
    shutil.rmtree(private_directory(out))


class CampaignJob:
    """The runs of a campaign, and a row of the table for each.

    Parameters
    ----------
    runs : sequence of Run
    table : FleetTable
    plan : Plan
        The steps for each recording.
    folder : Path
        Folder for the recordings, the same on all workers.
    keep : bool
        Whether the recordings stay there.
    tell : callable
        Called with the progress and the remaining time.

    Attributes
    ----------
    runs : dict of Run
        Runs by the keys of their rows.
    todo : list of str
        Keys without a row.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        table: FleetTable,
        plan: Plan,
        folder: Path,
        *,
        keep: bool = False,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._table, self._plan, self._folder, self._keep = table, plan, folder, keep
        version = versions().fluxbench
        self.runs = {run.key(plan, version): run for run in runs}
        self.todo = [key for key in self.runs if key not in table.keys]
        self._open, self._simulated = deque(self.todo), deque[str]()
        self._progress = JobProgress(len(self.todo), tell)

    def rows(self, client: Client | None = None, engine: EngineSettings | None = None) -> Iterator[FleetRow]:
        """Run the campaign; yields each row after it is in the table. Raises `StorageError`."""
        with closing(work_through(self._next_task, client, engine)) as answers:
            for done in answers:
                row = self._take(done)
                if row is not None:
                    yield row

    def _next_task(self) -> Task | None:
        if self._simulated:
            key = self._simulated.popleft()
            return Task(f"work-{key}", work_on, (self._order(key),))
        if not self._open:
            return None
        key = self._open.popleft()
        procedure = self.runs[key].procedure.model_dump(mode="json")
        return Task(f"simulate-{key}", simulate, (procedure, str(self._place(key))))

    def _take(self, done: Done) -> FleetRow | None:
        key = done.task.name.rpartition("-")[2]
        if done.task.work is simulate and done.failed is None:
            self._simulated.append(key)
            return None
        run = self.runs[key]
        fields = done.result or {**bare_fields(self._order(key)), "failed": done.failed}
        condition = run.condition
        truth = {"condition": condition.label, "hidden": condition.truths(), "batch": condition.variant or None}
        when = {"started_at": None}  # a simulation's time is irrelevant
        name = f"{fields.get('name') or ''} {condition.seed}"
        row = FleetRow.model_validate({**fields, **truth, **when, "name": name, "attempts": done.attempts})
        self._table.add(row.model_dump())
        self._progress.done(row.failed is not None)
        if not self._keep:
            shutil.rmtree(self._place(key), ignore_errors=True)
        return row

    def _order(self, key: str) -> Order:
        source = Source(url=str(self._place(key)), fingerprint=key)
        return Order(source=source, key=key, content_sha256=None, plan=self._plan)

    def _place(self, key: str) -> Path:
        return self._folder / key
