"""Threads that make the equations of a recording's batches: kernels and LAPACK release the interpreter's lock.

Every batch is made by itself, and what is made is put together in the batches' order: however many threads there are,
the result is the same to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

MAX_WORKERS = 4
"""Threads beyond which the part of an evaluation that holds the interpreter's lock leaves nothing to gain."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Whoever evaluates a function of every batch."""

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """The function's results in the items' order; what it raises first is raised."""


class SerialExecutor:
    """One item after the other, in the caller's own thread."""

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """As `Executor` has it."""
        return [function(item) for item in items]


class ThreadExecutor:
    """Items by the threads of a pool, which somebody else ends."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """As `Executor` has it."""
        futures: list[Future[Result]] = []
        try:
            futures.extend(self._pool.submit(function, item) for item in items)
            return [future.result() for future in futures]
        finally:
            # What raised ends the evaluation: nothing of it is still at work when the caller goes on.
            for future in futures:
                future.cancel()
            for future in futures:
                if not future.cancelled():
                    future.exception()


def workers_here() -> int:
    """As many as this process may use cores, up to `MAX_WORKERS`."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, MAX_WORKERS)


@contextmanager
def executor_of(workers: int) -> Iterator[Executor]:
    """An executor of so many threads; they have ended when the block is left, however it is left."""
    if workers <= 1:
        yield SerialExecutor()
        return
    with ThreadPoolExecutor(workers, thread_name_prefix="fluxbench-equations") as pool:
        try:
            yield ThreadExecutor(pool)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
