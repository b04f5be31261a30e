"""A campaign under way: motors are simulated, their recordings analysed, and the truth laid beside the answers.

The analysis is asked of a recording alone, in a task of its own; what was hidden stays with the client until the
answer is in.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.campaign._plan import Run
from orchestrator.fleet import (
    Done,
    FleetTable,
    Order,
    Plan,
    Progress,
    Source,
    Task,
    bare_fields,
    versions,
    work_on,
    work_through,
)
from protocols import Procedure
from protocols.fleet import FleetRow

if TYPE_CHECKING:
    from distributed import Client

    from orchestrator.fleet import EngineSettings


def simulate(procedure: dict[str, Any], place: str) -> None:
    """Run a procedure on its simulated drive into a new directory, and leave nothing there that knows the truth."""
    from orchestrator.api import run
    from orchestrator.runs import private_directory

    out = Path(place)
    for old in (out, private_directory(out)):  # of a worker that died over it
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
        What is done with each recording.
    folder : Path
        That gets the recordings, the same on all workers.
    keep : bool
        Whether they stay there.
    tell : callable
        Called with how far it is and how long it takes yet.

    Attributes
    ----------
    runs : dict of Run
        By the keys of their rows.
    todo : list of str
        Keys that have no row yet.
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
        self._left, self._made = deque(self.todo), deque[str]()
        self._progress = Progress(len(self.todo), tell)

    def rows(self, client: Client | None = None, engine: EngineSettings | None = None) -> Iterator[FleetRow]:
        """Do it; each row is handed out when the table has it. Raises `StorageError`."""
        with closing(work_through(self._next_task, client, engine)) as answers:
            for done in answers:
                row = self._take(done)
                if row is not None:
                    yield row

    def _next_task(self) -> Task | None:
        if self._made:
            key = self._made.popleft()
            return Task(f"work-{key}", work_on, (self._order(key),))
        if not self._left:
            return None
        key = self._left.popleft()
        procedure = self.runs[key].procedure.model_dump(mode="json")
        return Task(f"simulate-{key}", simulate, (procedure, str(self._place(key))))

    def _take(self, done: Done) -> FleetRow | None:
        key = done.task.name.rpartition("-")[2]
        if done.task.work is simulate and done.failed is None:
            self._made.append(key)
            return None
        run = self.runs[key]
        fields = done.result or {**bare_fields(self._order(key)), "failed": done.failed}
        told = run.condition
        truth = {"condition": told.label, "hidden": told.truths(), "batch": told.variant or None}
        when = {"started_at": None}  # of a simulation it tells nothing of the motor
        name = f"{fields.get('name') or ''} {told.seed}"
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
