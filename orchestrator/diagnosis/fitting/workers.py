"""Threads that evaluate a recording's batches: kernels and LAPACK release the interpreter's lock.

Batches are independent and combined in order, so that the result does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from orchestrator.operating_system.processes import available_cores

MAX_WORKERS = 4
"""Number of threads beyond which the interpreter's lock prevents any gain."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Executor:
    """Evaluates a function for every batch: in the threads of a pool, which the caller shuts down, or in its own."""

    pool: ThreadPoolExecutor | None = None

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """The function's results in the items' order; its first exception is raised."""
        if self.pool is None:
            return [function(item) for item in items]
        futures: list[Future[Result]] = []
        try:
            futures.extend(self.pool.submit(function, item) for item in items)
            return [future.result() for future in futures]
        finally:
            # After an exception, wait until no task of this evaluation is running.
            for future in futures:
                future.cancel()
            for future in futures:
                if not future.cancelled():
                    future.exception()


def workers_here() -> int:
    """Number of cores that this process may use, up to `MAX_WORKERS`."""
    return min(available_cores(), MAX_WORKERS)


@contextmanager
def executor_of(workers: int) -> Iterator[Executor]:
    """An executor with so many threads, which end with the block."""
    if workers <= 1:
        yield Executor()
        return
    with ThreadPoolExecutor(workers, thread_name_prefix="fluxbench-equations") as pool:
        try:
            yield Executor(pool)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
