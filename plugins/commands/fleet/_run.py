"""`fluxbench fleet run SOURCE... --out TABLE`: every recording below folders and URLs into one table."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from plugins.command_line import AsJson
from plugins.commands.fleet._work import Dashboard, Jobs, RetryFailed, Scheduler, complete
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
    out: Annotated[Path, typer.Option(help="Folder of the table: created, or extended.", metavar="TABLE")],
    do: Annotated[
        str, typer.Option(help="import, estimate, compare, diagnose, export; one or more.", metavar="STEPS")
    ] = "estimate",
    mapping: Annotated[
        Path | None,
        typer.Option(help="With import: YAML file that maps the columns of measurement files.", metavar="FILE"),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(help="Folder for the results and exports of this run.", metavar="DIR"),
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dashboard: Dashboard = False,
    limit: Annotated[int | None, typer.Option(min=1, help="Analyse only this many recordings.")] = None,
    retry_failed: RetryFailed = False,
    as_json: AsJson = False,
) -> int:
    """Analyse every recording below folders and URLs, a row of the table each.

    A second start continues: recordings that have a row are skipped.
    """
    from orchestrator.fleet import FleetJob, FleetTable, find_sources
    from orchestrator.formatting.progress import Progress
    from orchestrator.formatting.quantities import plural
    from orchestrator.formatting.sentences import visible

    began, tell = time.monotonic(), Progress()
    plan = _plan(do, mapping, keep)
    recordings = find_sources(sources, files=plan.mapping is not None, limit=limit, tell=tell)
    with FleetTable.opened(out, forget_failed=retry_failed) as table:
        job = FleetJob(recordings, table, plan, tell)
        complete(job, plural(len(recordings), "recording"), scheduler, jobs, dashboard=dashboard, quiet=as_json)
    report = job.report(out, time.monotonic() - began)
    if as_json:
        print(visible(report.model_dump_json(indent=2)))
    else:
        _print_row(report)
    return 0


def _plan(do: str, mapping: Path | None, keep: Path | None) -> Plan:
    """The requested steps; raises `typer.BadParameter` where options contradict each other."""
    from orchestrator.fleet import Plan
    from protocols.fleet import FleetStep

    every = get_args(FleetStep)
    chosen = {word.strip() for word in do.split(",") if word.strip()}
    unknown = sorted(chosen - set(every))
    if unknown or not chosen:
        raise typer.BadParameter(f"{', '.join(unknown) or do!r}; there is {', '.join(every)}", param_hint="--do")
    if ("import" in chosen) != (mapping is not None):
        raise typer.BadParameter("goes with --do import, which needs it", param_hint="--mapping")
    if "export" in chosen and keep is None:
        raise typer.BadParameter("is needed for --do export: its files go there", param_hint="--keep")
    if mapping is not None and not mapping.is_file():
        raise InputError(str(mapping), "", "no such file")
    steps = tuple(step for step in every if step in chosen)
    return Plan(
        steps=steps,
        mapping=None if mapping is None else mapping.resolve(),
        keep=None if keep is None else keep.resolve(),
    )


def _print_row(report: JobReport) -> None:
    from orchestrator.formatting.quantities import duration, plural
    from orchestrator.formatting.sentences import shown

    for failed in report.failed:
        message = failed.problem if failed.source in failed.problem else f"{failed.source}: {failed.problem}"
        print(shown(f"failed: {message}"))
    words = [plural(report.new, "new row") + (f", {len(report.failed)} of them failed" if report.failed else "")]
    again = f", {report.known_failed} of them failed (--retry-failed does those again)" if report.known_failed else ""
    words += [f"{report.known} known{again}"] if report.known else []
    words += [f"{report.same} the same as another"] if report.same else []
    count = plural(report.sources, "recording")
    print(shown(f"{report.table}: {count}: {'; '.join(words)}; {duration(report.seconds)}"))
