"""`fluxbench check`: what a procedure would do, without doing it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.cli._output import say, say_notes, say_table
from orchestrator.config import PlanSummary, StageRow, check_plan, make_plan, read_procedure
from orchestrator.engine import UsedPlugins, connected_drive
from orchestrator.presentation.quantities import duration, number, quantity
from orchestrator.stages import parse_stages


def check(source: str, drive: str | None, motor: Path | None, overrides: Sequence[str], as_json: bool) -> int:
    """Plan, hold the plan against limits and the drive's capabilities, print what would happen."""
    loaded = read_procedure(source, overrides=overrides, drive=drive, motor=motor)
    procedure = loaded.procedure
    UsedPlugins(parse_stages(procedure))
    with loaded.naming_its_places(), connected_drive(procedure, private=None) as (_, capabilities):
        summary = check_plan(make_plan(procedure, capabilities), capabilities)
    if as_json:
        print(summary.model_dump_json(indent=2))
    else:
        _print_summary(summary)
    return 0


def _print_summary(summary: PlanSummary) -> None:
    headings = ("stage", "written as", "points", "duration", "captured", "peak current", "peak voltage", "heat")
    rows = [(f"{row.index + 1} {row.stage}", f"stages.{row.index}", *_amounts(row)) for row in summary.stages]
    say_table(headings, [*rows, ("all", "", *_amounts(summary))])
    say(f"rms current {quantity(summary.rms_current_a, 'A')} (length of the vector, over the whole duration)")
    if summary.rows is not None and summary.bytes is not None:
        say(f"{number(summary.rows / 1e6, 3)} million rows, about {number(summary.bytes / 1e6, 3)} MB on disk")
    say_notes(summary.notes)
    say("nothing was energised")


def _amounts(row: StageRow | PlanSummary) -> tuple[str, ...]:
    return (
        str(row.points),
        duration(row.duration_s),
        duration(row.captured_s),
        quantity(row.peak_current_a, "A", 4),
        quantity(row.peak_voltage_v, "V", 4),
        quantity(row.energy_j, "J", 4),
    )
