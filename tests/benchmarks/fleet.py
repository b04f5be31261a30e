"""What a fleet's engine costs: empty tasks through the scheduler, and recordings a second on one worker and on two.

`python -m tests.benchmarks.fleet 100000` sends so many empty tasks.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.fleet import (
    ClusterSettings,
    FleetJob,
    FleetTable,
    Plan,
    Task,
    connected,
    find_sources,
    work_through,
)
from tests.orchestrator.fleet.small import small_recordings
from tests.orchestrator.fleet.tasks import nothing

if TYPE_CHECKING:
    from distributed import Client

EMPTY, RECORDINGS = 5000, 120


def main(empty: int = EMPTY) -> None:
    """Print the figures."""
    for jobs in (1, 2):
        with connected(ClusterSettings(jobs=jobs)) as client:
            _empty(client, 100)
            print(f"{jobs} workers: {_empty(client, empty)}", flush=True)
            print(f"{jobs} workers: {_recordings(client, jobs)}", flush=True)


def _empty(client: Client, count: int) -> str:
    began, cpu = time.perf_counter(), time.process_time()
    done = sum(1 for _ in work_through(_so_many(count), client))
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"{done} empty tasks: {1e3 * seconds / done:.2f} ms each, {1e3 * cpu / done:.2f} ms of the processor in client "
        f"and scheduler, {peak:.0f} MB"
    )


def _so_many(count: int) -> Callable[[], Task | None]:
    rest = iter(range(count))

    def next_task() -> Task | None:
        number = next(rest, None)
        return None if number is None else Task(f"empty-{number}", nothing, (number,))

    return next_task


def _recordings(client: Client, jobs: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        bench = Path(folder) / "bench"
        small_recordings(bench, RECORDINGS)
        found = find_sources([str(bench)], files=False, limit=None, tell=lambda _: None)
        with FleetTable.opened(Path(folder) / "table") as table:
            list(FleetJob(found[: 10 * jobs], table, Plan()).rows(client))
            began, cpu = time.perf_counter(), time.process_time()
            rows = list(FleetJob(found, table, Plan()).rows(client))
            seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    busy = sum(row.seconds for row in rows)
    return (
        f"{len(rows) / seconds:.2f} recordings a second, {1e3 * busy / len(rows):.0f} ms each on a worker, which is at "
        f"work {100.0 * busy / seconds / jobs:.0f} % of the time; {1e3 * cpu / len(rows):.1f} ms of the processor each "
        f"in client and scheduler; {max(row.peak_mb for row in rows):.0f} MB a worker"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
