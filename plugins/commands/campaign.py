"""`fluxbench campaign FILE --out TABLE`: which effects a bench would find, by many simulated runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from plugins.command_line import AsJson, entry_point
from plugins.commands.fleet._work import Dashboard, Jobs, RetryFailed, Scheduler, complete

if TYPE_CHECKING:
    from orchestrator.fleet.campaign import PowerReport

HELP_GROUP = "Try and prove"
"""Its place in the list of commands."""


RECORDINGS, REPORT = ".recordings", "_campaign.json"
"""Names in the table's folder that readers of Parquet skip."""


def campaign(
    file: Annotated[Path, typer.Argument(help="YAML file: procedures, motors, hidden effects, seeds.", metavar="FILE")],
    out: Annotated[Path, typer.Option(help="Folder of the table: created, or extended.", metavar="TABLE")],
    keep: Annotated[
        Path | None, typer.Option(help="Folder that keeps the simulated recordings.", metavar="DIR")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dashboard: Dashboard = False,
    retry_failed: RetryFailed = False,
    as_json: AsJson = False,
) -> int:
    """Simulate motors with hidden effects, diagnose them, and print which sizes are found with what probability.

    A second start continues the campaign.
    """
    from orchestrator.fleet import FleetTable, read_table
    from orchestrator.fleet.campaign import CampaignJob, check_runs, load_campaign, power_of, runs_of
    from orchestrator.formatting.progress import Progress
    from orchestrator.formatting.sentences import visible
    from orchestrator.recording import replace_file

    plan = load_campaign(file)
    runs = list(runs_of(plan))
    check_runs(runs)
    with FleetTable.opened(out, forget_failed=retry_failed) as table:
        folder = (keep or out / RECORDINGS).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        job = CampaignJob(runs, table, plan.analysis(), folder, keep=keep is not None, tell=Progress())
        complete(job, f"{len(job.runs)} virtual commissionings", scheduler, jobs, dashboard=dashboard, quiet=as_json)
    rows = [row for row in read_table(out) if row.key in job.runs]  # the table may hold another campaign
    report = power_of(rows, name=plan.name, table=str(out), found_with=plan.found_with)
    replace_file(out / REPORT, visible(report.model_dump_json(indent=1)).encode())
    if as_json:
        print(visible(report.model_dump_json(indent=2)))
    else:
        _print_line(report, plan.found_with)
    return 0


command = entry_point(campaign, "Example: fluxbench campaign campaign.yaml --out power")


def _print_line(report: PowerReport, found_with: float) -> None:
    from orchestrator.formatting.names import plain
    from orchestrator.formatting.quantities import number, percent, plural
    from orchestrator.formatting.sentences import shown, text_table

    rows = [
        (
            row.condition,
            plain(row.effect),
            f"{row.parameter} {number(row.size)}",
            f"{row.found} of {row.runs}",
            f"{percent(100.0 * row.low, 2)} to {percent(100.0 * row.high, 2)}",
            "-" if row.ratio is None else f"{row.ratio:.3f}",
            "-" if row.inside is None else f"{row.inside} of {row.found}",
        )
        for row in report.rows
    ]
    head = ("condition", "effect", "size", "found", "95 %", "found / true", "interval holds it")
    if rows:
        print(shown(text_table(head, rows, numbers=False)))
    for smallest in report.smallest:
        what = f"{plain(smallest.effect)}: {smallest.parameter}"
        if smallest.size is None:
            print(shown(f"{what}: none of these sizes is found in {percent(100.0 * found_with, 2)} of the runs"))
        else:
            print(shown(f"{what}: found from {number(smallest.size)} on"))
    for failure in report.failures:
        print(shown(f"failed {failure.count} times: {failure.what}"))
    diagnosed = f", {report.false_names} of {report.judged} diagnosed with a false name" if report.judged else ""
    print(f"{plural(report.runs, 'run')}{diagnosed}, {report.failed} failed: {report.table}")
