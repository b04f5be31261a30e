"""Many independent tasks on however many workers: few in flight, each answered once, a dead worker forgiven once.

What the tasks are is nobody's business here. With a dask client they run wherever its scheduler has workers; without
one, in this process, one after the other.
"""

from __future__ import annotations

import time
import uuid
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import Field

from orchestrator.formatting.sentences import one_line
from protocols import Strict

if TYPE_CHECKING:
    from distributed import Client


class EngineSettings(Strict):
    """How much is asked of the workers at once."""

    in_flight_per_worker: int = Field(default=4, ge=1)
    """Tasks that are with the scheduler, for each thread of a worker: the others wait here, where they cost nothing."""
    attempts: int = Field(default=2, ge=1)
    """How often a task may be begun by a worker that then dies."""
    count_workers_s: float = Field(default=2.0, gt=0)
    """How often the workers are counted."""


@dataclass(frozen=True)
class Task:
    """One thing to do: `work(*arguments)`, a function that every worker can import."""

    name: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    beside: Any = None
    """The `handle` of an answer: its worker has something at hand, and gets this too where it can; `work` is then
    called with that answer's result as a last argument."""


@dataclass(frozen=True)
class Done:
    """A task that is over."""

    task: Task
    result: Any
    failed: str | None
    """One line where there is no result."""
    attempts: int
    handle: Any = None
    """Keeps what its worker has of it alive; None where that was done here."""


def work_through(
    next_task: Callable[[], Task | None], client: Client | None = None, settings: EngineSettings | None = None
) -> Generator[Done, None, None]:
    """Do all tasks, in order of completion.

    Parameters
    ----------
    next_task : callable
        The next one, or None while there is none: asked again after each answer, which may have brought new ones.
    client : distributed.Client, optional
        Without one, everything is done here.

    Raises
    ------
    StorageError
        Where the scheduler is gone; what was answered until then stays answered.
    """
    if client is not None:
        return _OnCluster(next_task, client, settings or EngineSettings()).answers()
    return _here(next_task)


def _here(next_task: Callable[[], Task | None]) -> Generator[Done, None, None]:
    while (task := next_task()) is not None:
        try:
            result, failed = task.work(*task.arguments), None
        except Exception as error:  # whatever one task raises is its own
            result, failed = None, said_of(error)
        yield Done(task, result, failed, 1)


def said_of(error: BaseException) -> str:
    """An error as one line, with its kind where it is none of ours."""
    from protocols import FluxbenchError

    told = one_line(str(error)) or type(error).__name__
    return told if isinstance(error, FluxbenchError) else f"{type(error).__name__}: {told}"


def _alone(work: Callable[..., Any], *arguments: Any) -> Any:
    """What a worker does: libraries that would themselves use a cluster that is there (xarray's locks) see none."""
    import dask

    with dask.config.set(scheduler="synchronous"):
        return work(*arguments)


class _OnCluster:
    """The tasks that are in flight, and those that were lost with a worker."""

    def __init__(self, next_task: Callable[[], Task | None], client: Client, settings: EngineSettings) -> None:
        from distributed import as_completed

        self._next_task, self._client, self._settings = next_task, client, settings
        self._flying: dict[Any, tuple[Task, int]] = {}
        self._lost: deque[tuple[Task, int]] = deque()
        self._finished = as_completed(loop=client.loop)
        self._job = uuid.uuid4().hex[:8]
        self._address = client.scheduler.address if client.scheduler is not None else "?"
        self._threads, self._count_again = 1, 0.0

    def answers(self) -> Generator[Done, None, None]:
        try:
            self._fill()
            while self._flying:
                future = next(self._finished)
                task, attempt = self._flying.pop(future)
                done = self._judged(future, task, attempt)
                del future, task  # what nobody keeps, the scheduler forgets
                if done is not None:
                    yield done
                self._fill()
        finally:
            if self._flying:
                self._client.cancel(list(self._flying), force=True)

    def _fill(self) -> None:
        room = self._settings.in_flight_per_worker * self._workers()
        while len(self._flying) < room and (task := self._next_task()) is not None:
            self._submit(task, 1)
        if self._flying:
            return
        # What was lost with a worker comes last, one to a worker: none of it pays twice for what lay beside it.
        for _ in range(min(len(self._lost), self._workers())):
            self._submit(*self._lost.popleft())

    def _submit(self, task: Task, attempt: int) -> None:
        # A worker that is named would be waited for, also after its death: the scheduler goes by whose data it is.
        beside = () if task.beside is None or attempt > 1 else (task.beside,)
        future = self._client.submit(
            _alone, task.work, *task.arguments, *beside, key=f"{self._job}-{task.name}-{attempt}", pure=False
        )
        self._flying[future] = task, attempt
        self._finished.add(future)

    def _judged(self, future: Any, task: Task, attempt: int) -> Done | None:
        from distributed.scheduler import KilledWorker

        from protocols import StorageError

        try:
            # Where its worker has died since, it is waited for again.
            return Done(task, future.result(), None, attempt, future)
        except KilledWorker:
            if attempt < self._settings.attempts:
                self._lost.append((task, attempt + 1))
                return None
            return Done(task, None, f"its worker died {attempt} times", attempt)
        except Exception as error:
            if future.status != "error":
                gone = f"the scheduler {self._address} is gone; started again, the job goes on where it was"
                raise StorageError(gone) from None
            return Done(task, None, said_of(error), attempt)

    def _workers(self) -> int:
        """Threads of all workers; as counted before, while there is none because it is being started again."""
        now = time.monotonic()
        if now >= self._count_again:
            self._count_again = now + self._settings.count_workers_s
            self._threads = sum(self._client.nthreads().values()) or self._threads
        return self._threads
