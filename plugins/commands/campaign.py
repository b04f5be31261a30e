"""`fluxbench campaign FILE --out TABLE`: thousands of virtual commissionings: which effects a bench would see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from orchestrator.fleet.campaign import PowerReport

app = typer.Typer(add_completion=False, rich_markup_mode=None)
RECORDINGS, REPORT = ".recordings", "_campaign.json"
"""In the table's folder, where readers of Parquet pass over both."""


@app.command()
def campaign(
    file: Annotated[Path, typer.Argument(help="YAML file: procedures, motors, what is hidden, seeds.")],
    out: Annotated[Path, typer.Option(help="Folder of the table: made, or gone on with.", metavar="TABLE")],
    keep: Annotated[
        Path | None, typer.Option(help="Folder in which the simulated recordings stay.", metavar="DIR")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes here.", show_default="one a core")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Of a dask cluster that is there, instead of processes here.", metavar="tcp://..."),
    ] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Do again what failed before.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """Simulate motors with hidden effects, diagnose them, and say which sizes are found with what probability.

    Started again, it goes on where it was.
    """
    from orchestrator.fleet import ClusterSettings, FleetTable, connected, read_table
    from orchestrator.fleet.campaign import CampaignJob, check_runs, load_campaign, power_of, runs_of
    from orchestrator.formatting.progress import Progress
    from orchestrator.formatting.sentences import visible
    from orchestrator.recording import replace_file

    plan = load_campaign(file)
    runs = list(runs_of(plan))
    check_runs(runs)
    settings = ClusterSettings(scheduler=scheduler, **({} if jobs is None else {"jobs": jobs}))
    with FleetTable.opened(out, forget_failed=retry_failed) as table:
        folder = (keep or out / RECORDINGS).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        job = CampaignJob(runs, table, plan.analysis(), folder, keep=keep is not None, tell=Progress())
        if job.todo:
            with connected(settings) as client:
                if not as_json:
                    what = f"{len(job.todo)} of {len(job.runs)} virtual commissionings to do"
                    print(f"{what}; watch them on {client.dashboard_link}")
                for _ in job.rows(client):
                    pass
    rows = [row for row in read_table(out) if row.key in job.runs]  # another campaign may be in the same table
    report = power_of(rows, name=plan.name, table=str(out), found_with=plan.found_with)
    replace_file(out / REPORT, visible(report.model_dump_json(indent=1)).encode())
    if as_json:
        print(visible(report.model_dump_json(indent=2)))
    else:
        _print_line(report, plan.found_with)
    return 0


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    return int(app(list(arguments), prog_name="fluxbench campaign", standalone_mode=False) or 0)


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
