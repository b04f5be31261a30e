"""`fluxbench fleet run SOURCE... --out TABLE`: every recording below folders and URLs into one table."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from protocols import InputError

if TYPE_CHECKING:
    from orchestrator.fleet import JobReport, Plan


def run(
    sources: Annotated[
        list[str],
        typer.Argument(
            help="Folders or URLs (s3://, gcs://, sftp://) with recordings below them.", metavar="SOURCE..."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the table: made, or gone on with.", metavar="TABLE")],
    do: Annotated[str, typer.Option(help="import, estimate, compare, diagnose, export; one or more.")] = "estimate",
    mapping: Annotated[
        Path | None, typer.Option(help="With import: YAML file that says what a measurement file's columns are.")
    ] = None,
    keep: Annotated[
        Path | None, typer.Option(help="Folder for the results and exports of each that is done now.", metavar="DIR")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes here.", show_default="one a core")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Of a dask cluster that is there, instead of processes here.", metavar="tcp://..."),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first so many.")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Do again what failed before.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """Work on every recording below folders and URLs; a row of the table each.

    Started again, it goes on where it was: what has a row is not done twice.
    """
    from orchestrator.fleet import ClusterSettings, FleetJob, FleetTable, connected, find_sources
    from orchestrator.formatting.progress import Progress
    from orchestrator.formatting.quantities import plural
    from orchestrator.formatting.sentences import visible

    began, tell = time.monotonic(), Progress()
    plan = _plan(do, mapping, keep)
    settings = ClusterSettings(scheduler=scheduler, **({} if jobs is None else {"jobs": jobs}))
    found = find_sources(sources, files=plan.mapping is not None, limit=limit, tell=tell)
    with FleetTable.opened(out, forget_failed=retry_failed) as table:
        job = FleetJob(found, table, plan, tell)
        if job.todo:
            with connected(settings) as client:
                if not as_json:
                    what = f"{len(job.todo)} of {plural(len(found), 'recording')} to do"
                    print(f"{what}; watch them on {client.dashboard_link}")
                for _ in job.rows(client):
                    pass
    report = job.report(out, time.monotonic() - began)
    if as_json:
        print(visible(report.model_dump_json(indent=2)))
    else:
        _say(report)
    return 0


def _plan(do: str, mapping: Path | None, keep: Path | None) -> Plan:
    """What is asked for; raises `typer.BadParameter` where it does not go together."""
    from orchestrator.fleet import Plan
    from protocols.fleet import FleetStep

    every = get_args(FleetStep)
    asked = {word.strip() for word in do.split(",") if word.strip()}
    unknown = sorted(asked - set(every))
    if unknown or not asked:
        raise typer.BadParameter(f"{', '.join(unknown) or do!r}; there is {', '.join(every)}", param_hint="--do")
    if ("import" in asked) != (mapping is not None):
        raise typer.BadParameter("goes with --do import, which needs it", param_hint="--mapping")
    if "export" in asked and keep is None:
        raise typer.BadParameter("is needed for --do export: its files go there", param_hint="--keep")
    if mapping is not None and not mapping.is_file():
        raise InputError(str(mapping), "", "no such file")
    steps = tuple(step for step in every if step in asked)
    return Plan(
        steps=steps,
        mapping=None if mapping is None else mapping.resolve(),
        keep=None if keep is None else keep.resolve(),
    )


def _say(report: JobReport) -> None:
    from orchestrator.formatting.quantities import duration, plural
    from orchestrator.formatting.sentences import shown

    for failed in report.failed:
        told = failed.problem if failed.source in failed.problem else f"{failed.source}: {failed.problem}"
        print(shown(f"failed: {told}"))
    words = [plural(report.new, "new row") + (f", {len(report.failed)} of them failed" if report.failed else "")]
    again = f", {report.known_failed} of them failed (--retry-failed does those again)" if report.known_failed else ""
    words += [f"{report.known} known{again}"] if report.known else []
    words += [f"{report.same} the same as another"] if report.same else []
    found = plural(report.sources, "recording")
    print(shown(f"{report.table}: {found}: {'; '.join(words)}; {duration(report.seconds)}"))
