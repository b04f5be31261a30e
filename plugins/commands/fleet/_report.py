"""`fluxbench fleet report`: statistics of a fleet's table as a page, as JSON and in a few lines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from plugins.command_line import AsJson
from plugins.commands.fleet._damage import SkipDamaged, exit_code

if TYPE_CHECKING:
    from orchestrator.fleet.statistics import FleetTable
    from protocols.fleet_report import FleetLimits


def report(
    table: Annotated[
        str, typer.Argument(help="A fleet's table: a Parquet file, or a folder of them.", metavar="TABLE")
    ],
    limits: Annotated[
        Path | None, typer.Option(help="YAML file with limits that each recording is tested against.", metavar="FILE")
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            help="Compare with earlier recordings: another table, or `pairs`: each motor's first and last.",
            metavar="TABLE|pairs",
        ),
    ] = None,
    rrd: Annotated[bool, typer.Option("--rrd", help="Write fleet-report.rrd too, for `fluxbench view`.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the page and its JSON; by default _report in the table's folder.", metavar="FILE"
        ),
    ] = None,
    skip_damaged: SkipDamaged = False,
    as_json: AsJson = False,
) -> int:
    """Write distributions, outliers, drift, batches, limits and pairs of a fleet as one page, and as JSON.

    Parts of the table that cannot be read are named and counted; the exit code is then 3.
    """
    from orchestrator.fleet.statistics import WITHIN, outlier_rows, read_fleet, read_limits, report_of
    from orchestrator.formatting.sentences import shown, text_table, visible
    from orchestrator.interface.api import one_thread
    from plugins.streams.report import write_fleet_report

    with one_thread():
        fleet = read_fleet(table)
        bounds = None if limits is None else read_limits(limits)
        if bounds is not None:
            _require_known(bounds, str(limits), fleet)
        before = None if against in (None, WITHIN) else read_fleet(str(against))
        stats = report_of(fleet, limits=bounds, against=before, within=against == WITHIN)
        place = Path(table)
        # Readers of a folder of Parquet files skip names with a leading underscore.
        folder = out if out is not None else place / "_report" if place.is_dir() else place.parent
        files = [*write_fleet_report(stats, folder)]
        if rrd:
            from plugins.streams.rerun import make_fleet_view

            files.append(folder / "fleet-report.rrd")
            make_fleet_view(stats, files[-1])
    if as_json:
        print(visible(stats.model_dump_json(indent=2)))
        return exit_code(stats.damaged, skip_damaged)
    rows = outlier_rows(stats)
    for line in (*(remark.text for remark in stats.remarks), *([text_table(rows[0], rows[1:], False)] if rows else [])):
        print(shown(line))
    for file in files:
        print(shown(str(file)))
    return exit_code(stats.damaged, skip_damaged)


def _require_known(limits: FleetLimits, place: str, table: FleetTable) -> None:
    """Raise `InputError` for a limit of a quantity that neither the table nor an installed effect has."""
    from orchestrator.fleet.statistics import require_known
    from orchestrator.registry.plugins import PluginKind, make_plugins

    if set(limits.quantities) <= set(table.columns):
        return
    effects = make_plugins(PluginKind.EFFECTS)
    known = [f"{effect.name}.{p.name}" for effect in effects for p in effect.Parameters.declared()]
    require_known(limits, place, table, known)
