"""`fluxbench check`: a dry run of a procedure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.config import Plan, PlanSummary, StageRow, check_plan, make_plan, read_procedure
from orchestrator.config.time_constants import plan_notes
from orchestrator.engine import UsedPlugins, connected_drive, host_latency
from orchestrator.formatting.quantities import duration, number, quantity
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table
from orchestrator.stages import parse_stages
from protocols import Capabilities, Drive

if TYPE_CHECKING:
    from orchestrator.experiment_design.machine import Machine
    from orchestrator.experiment_design.outlook import IsolabilityReport


def check(
    source: str,
    drive: str | None,
    motor: Path | None,
    overrides: Sequence[str],
    as_json: bool,
    rehearsal: RehearsalOptions | None = None,
) -> int:
    """Plan a procedure, check the plan against limits and the drive's capabilities, and print its summary.

    With `rehearsal`, print the isolability of effects as well; as JSON, that alone.
    """
    loaded = read_procedure(source, overrides=overrides, drive=drive, motor=motor)
    procedure = loaded.procedure
    if not as_json:
        say_notes(loaded.notes)
    UsedPlugins(parse_stages(procedure))
    with loaded.locating_errors(), connected_drive(procedure, private=None) as (connected, capabilities):
        plan = make_plan(procedure, capabilities)
        summary = check_plan(plan, capabilities)
        summary = summary.model_copy(update={"notes": (*summary.notes, *_heartbeat_notes(connected, capabilities))})
        summary = summary.model_copy(update={"notes": (*summary.notes, *plan_notes(plan, capabilities))})
        report = None if rehearsal is None else rehearsal.outlook(plan, capabilities)
    if as_json and report is not None:
        say_document(report.model_dump_json(indent=2))
    elif as_json:
        say_document(summary.model_dump_json(indent=2))
    else:
        _print_summary(summary)
        if report is not None:
            from orchestrator.interface.cli._isolability import say_isolability

            say_isolability(report)
    return 0


def _heartbeat_notes(drive: Drive, capabilities: Capabilities) -> list[str]:
    """Whether this host, as busy as it is, keeps the watchdog of a real drive from tripping."""
    watchdog_s = capabilities.watchdog_s
    if capabilities.simulated or watchdog_s is None:
        return []
    gap = host_latency(drive)
    note = (
        f"heartbeats come from {gap.sender}, late by {1e3 * gap.worst_s:.2g} ms at most in a second: "
        f"a watchdog of {gap.shortest_watchdog_s:.2g} s or more does not trip"
    )
    if watchdog_s >= gap.shortest_watchdog_s:
        return [f"{note}; the drive's is {watchdog_s:g} s"]
    return [f"{note}, and the drive's {watchdog_s:g} s may: close other programs, or make it longer"]


@dataclass(frozen=True)
class RehearsalOptions:
    """Options of a plan's rehearsal.

    Attributes
    ----------
    model : str or None
        A flux map or model file; by default the nameplate's constant inductances.
    effects : Path or None
        Python file with candidates beside the installed ones.
    noise_a : float or None
    """

    model: str | None = None
    effects: Path | None = None
    noise_a: float | None = None

    def machine(self, plan: Plan, drive: Capabilities) -> Machine:
        """The machine of the rehearsal."""
        from orchestrator.experiment_design.machine import Machine
        from orchestrator.experiment_design.rehearsal import machine_of
        from orchestrator.interface.api import chosen_model

        nameplate = Machine.of(plan.procedure.motor, plan.procedure.name)
        model = chosen_model(self.model)
        return nameplate if model is None else machine_of(nameplate, plan, drive, model)

    def outlook(self, plan: Plan, drive: Capabilities) -> IsolabilityReport:
        """The isolability of effects by the plan."""
        from orchestrator.experiment_design.outlook import outlook
        from orchestrator.interface.api import chosen_effects

        effects = chosen_effects(self.effects or ())
        return outlook(plan, drive, self.machine(plan, drive), effects, noise_a=self.noise_a)


def _print_summary(summary: PlanSummary) -> None:
    headings = ("stage", "written as", "points", "duration", "captured", "peak current", "peak voltage", "heat")
    rows = [(f"{row.index + 1} {row.stage}", f"stages.{row.index}", *_amounts(row)) for row in summary.stages]
    say_table(headings, [*rows, ("all", "", *_amounts(summary))])
    if [row.index for row in summary.stages] != list(range(len(rows))):
        say("a stage whose number is left out measures nothing: it asks the operator, or computes")
    say(f"rms current {quantity(summary.rms_current_a, 'A')} (length of the vector, over the whole duration)")
    if summary.rows is not None and summary.bytes is not None:
        say(f"{number(summary.rows / 1e6, 3)} million rows, about {number(summary.bytes / 1e6, 3)} MB on disk")
    say(*(f"warning: {warning}" for warning in summary.warnings))
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
