"""`fluxbench check`: what a procedure would do, without doing it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.cli._tables import amount, duration, print_table
from orchestrator.config import PlanSummary, check_plan, make_plan, read_procedure
from orchestrator.engine import chosen_effects, chosen_estimators, connected_drive


def check(source: str, drive: str | None, motor: Path | None, overrides: Sequence[str], as_json: bool) -> int:
    """Plan, hold the plan against limits and the drive's capabilities, print what would happen."""
    loaded = read_procedure(source, overrides=overrides, drive=drive, motor=motor)
    procedure = loaded.procedure
    chosen_estimators(procedure)
    chosen_effects(procedure)
    with loaded.naming_its_places(), connected_drive(procedure, private=None) as (_, capabilities):
        summary = check_plan(make_plan(procedure, capabilities), capabilities)
    if as_json:
        print(summary.model_dump_json(indent=2))
    else:
        _print_summary(summary)
    return 0


def _print_summary(summary: PlanSummary) -> None:
    headings = ("stage", "written as", "points", "duration", "captured", "peak current", "peak voltage", "heat")
    rows = [
        (
            f"{row.index + 1} {row.stage}",
            f"stages.{row.index}",
            str(row.points),
            duration(row.duration_s),
            duration(row.captured_s),
            amount(row.peak_current_a, "A"),
            amount(row.peak_voltage_v, "V"),
            amount(row.energy_j, "J"),
        )
        for row in summary.stages
    ]
    total = (
        "all",
        "",
        str(summary.points),
        duration(summary.duration_s),
        duration(summary.captured_s),
        amount(summary.peak_current_a, "A"),
        amount(summary.peak_voltage_v, "V"),
        amount(summary.energy_j, "J"),
    )
    print_table(headings, [*rows, total])
    print(f"rms current {amount(summary.rms_current_a, 'A')} (length of the vector, over the whole duration)")
    if summary.rows is not None and summary.bytes is not None:
        print(f"{summary.rows / 1e6:.3g} million rows, about {summary.bytes / 1e6:.3g} MB on disk")
    for note in summary.notes:
        print(f"note: {note}")
    print("nothing was energised")
