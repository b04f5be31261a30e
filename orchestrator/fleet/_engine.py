"""Many independent tasks on any number of workers: few in flight, one repetition after a worker's death.

Knows nothing of the tasks' content. With a dask client they run on its scheduler's workers; without one, in this
process, one after the other.
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
    """Load and retries of the workers."""

    in_flight_per_worker: int = Field(default=4, ge=1)
    """Tasks at the scheduler per worker thread; the others wait in this process at no cost."""
    attempts: int = Field(default=2, ge=1)
    """Attempts of a task whose worker dies."""
    count_workers_s: float = Field(default=2.0, gt=0)
    """Time between two counts of the workers [s]."""


@dataclass(frozen=True)
class Task:
    """One call `work(*arguments)` of a function that every worker can import."""

    name: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    near: Any = None
    """The `handle` of another result: the task runs on that result's worker where possible, and `work` gets that
    result as its last argument."""


@dataclass(frozen=True)
class Done:
    """A finished task."""

    task: Task
    result: Any
    failed: str | None
    """One line where there is no result."""
    attempts: int
    handle: Any = None
    """Keeps the worker's copy of the result alive; None for tasks of this process."""


def work_through(
    next_task: Callable[[], Task | None], client: Client | None = None, settings: EngineSettings | None = None
) -> Generator[Done, None, None]:
    """The finished tasks, in order of completion.

    Parameters
    ----------
    next_task : callable
        Returns the next task, or None while there is none; called again after each result, which may have added tasks.
    client : distributed.Client, optional
        Without one, the tasks run in this process.

    Raises
    ------
    StorageError
        Where the scheduler is gone; results until then stay valid.
    """
    if client is not None:
        return _OnCluster(next_task, client, settings or EngineSettings()).answers()
    return _run_locally(next_task)


def _run_locally(next_task: Callable[[], Task | None]) -> Generator[Done, None, None]:
    while (task := next_task()) is not None:
        try:
            result, failed = task.work(*task.arguments), None
        except Exception as error:  # an error of one task does not end the others
            result, failed = None, error_line(error)
        yield Done(task, result, failed, 1)


def error_line(error: BaseException) -> str:
    """An error as one line, with its type where it is none of ours."""
    from protocols import FluxbenchError

    message = one_line(str(error)) or type(error).__name__
    return message if isinstance(error, FluxbenchError) else f"{type(error).__name__}: {message}"


def _call(work: Callable[..., Any], *arguments: Any) -> Any:
    """The call on a worker, where libraries that would use the cluster themselves (xarray's locks) see none."""
    import dask

    with dask.config.set(scheduler="synchronous"):
        return work(*arguments)


class _OnCluster:
    """Tasks on a cluster: those in flight, and those lost with a worker."""

    def __init__(self, next_task: Callable[[], Task | None], client: Client, settings: EngineSettings) -> None:
        from distributed import as_completed

        self._next_task, self._client, self._settings = next_task, client, settings
        self._in_flight: dict[Any, tuple[Task, int]] = {}
        self._lost: deque[tuple[Task, int]] = deque()
        self._finished = as_completed(loop=client.loop)
        self._job = uuid.uuid4().hex[:8]
        self._address = client.scheduler.address if client.scheduler is not None else "?"
        self._threads, self._next_count_s = 1, 0.0

    def answers(self) -> Generator[Done, None, None]:
        try:
            self._fill()
            while self._in_flight:
                future = next(self._finished)
                task, attempt = self._in_flight.pop(future)
                done = self._result_of(future, task, attempt)
                del future, task  # the scheduler forgets futures without references
                if done is not None:
                    yield done
                self._fill()
        finally:
            if self._in_flight:
                self._client.cancel(list(self._in_flight), force=True)

    def _fill(self) -> None:
        limit = self._settings.in_flight_per_worker * self._workers()
        while len(self._in_flight) < limit and (task := self._next_task()) is not None:
            self._submit(task, 1)
        if self._in_flight:
            return
        # Lost tasks come last, one per worker, so that no task is lost twice through another one.
        for _ in range(min(len(self._lost), self._workers())):
            self._submit(*self._lost.popleft())

    def _submit(self, task: Task, attempt: int) -> None:
        # The scheduler would wait for a named worker even after its death, but it places tasks by their data.
        near = () if task.near is None or attempt > 1 else (task.near,)
        future = self._client.submit(
            _call, task.work, *task.arguments, *near, key=f"{self._job}-{task.name}-{attempt}", pure=False
        )
        self._in_flight[future] = task, attempt
        self._finished.add(future)

    def _result_of(self, future: Any, task: Task, attempt: int) -> Done | None:
        from distributed.scheduler import KilledWorker

        from protocols import StorageError

        try:
            # Where its worker has died since, this waits for it again.
            return Done(task, future.result(), None, attempt, future)
        except KilledWorker:
            if attempt < self._settings.attempts:
                self._lost.append((task, attempt + 1))
                return None
            return Done(task, None, f"its worker died {attempt} times", attempt)
        except Exception as error:
            if future.status != "error":
                gone = f"the scheduler {self._address} is gone; started again, the job continues where it stopped"
                raise StorageError(gone) from None
            return Done(task, None, error_line(error), attempt)

    def _workers(self) -> int:
        """Threads of all workers; the last count while there is none because workers restart."""
        now = time.monotonic()
        if now >= self._next_count_s:
            self._next_count_s = now + self._settings.count_workers_s
            self._threads = sum(self._client.nthreads().values()) or self._threads
        return self._threads
