"""Shared by the commands that fill a fleet's table by workers: options and execution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from orchestrator.fleet import FleetJob
    from orchestrator.fleet.campaign import CampaignJob

Jobs = Annotated[int | None, typer.Option(min=1, help="Local worker processes.", show_default="one a core")]
Scheduler = Annotated[
    str | None,
    typer.Option(help="An existing dask scheduler, used instead of local processes.", metavar="tcp://..."),
]
RetryFailed = Annotated[bool, typer.Option("--retry-failed", help="Repeat what failed before.")]


def complete(job: FleetJob | CampaignJob, what: str, scheduler: str | None, jobs: int | None, *, quiet: bool) -> None:
    """Run a job's remaining items on the workers; `what` describes all items for the message."""
    from orchestrator.fleet import ClusterSettings, connected

    if not job.todo:
        return
    settings = ClusterSettings(scheduler=scheduler, **({} if jobs is None else {"jobs": jobs}))
    with connected(settings) as client:
        if not quiet:
            print(f"{len(job.todo)} of {what} to do; watch them on {client.dashboard_link}")
        for _ in job.rows(client):
            pass
