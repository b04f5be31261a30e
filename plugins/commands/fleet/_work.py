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
Dashboard = Annotated[
    bool,
    typer.Option(
        "--dashboard",
        help="Show the local workers on a page of dask's on 127.0.0.1. It has no token: every user of this machine can "
        "read it.",
    ),
]
DASHBOARD_PORT = 8787


def complete(
    job: FleetJob | CampaignJob,
    what: str,
    scheduler: str | None,
    jobs: int | None,
    *,
    dashboard: bool = False,
    quiet: bool,
) -> None:
    """Run a job's remaining items on the workers; `what` describes all items for the message."""
    from orchestrator.fleet import ClusterSettings, connected

    if not job.todo:
        return
    if dashboard and scheduler is not None:
        raise typer.BadParameter("is of the local workers; an existing scheduler has its own", param_hint="--dashboard")
    port = DASHBOARD_PORT if dashboard else None
    settings = ClusterSettings(scheduler=scheduler, dashboard_port=port, **({} if jobs is None else {"jobs": jobs}))
    with connected(settings) as client:
        if not quiet:
            page = f"; {client.dashboard_link} shows them to every user of this machine" if dashboard else ""
            print(f"{len(job.todo)} of {what} to do{page}", flush=True)
        for _ in job.rows(client):
            pass
