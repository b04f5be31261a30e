"""Runs with results and without samples: their journal and files are real, their numbers chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orchestrator.diagnosis.reporting.diagnosis_file import save_diagnosis
from orchestrator.estimation.results import write_results
from orchestrator.runs import RunDirectory
from protocols import (
    Capabilities,
    CheckOutcome,
    DiagnosisWords,
    EstimationReport,
    FluxMap,
    Limits,
    MapChecks,
    MapReport,
    Message,
    Procedure,
    Remark,
    ResistanceEstimate,
    RunEnded,
    RunStarted,
    UsabilityCheck,
    Verdict,
)
from tests.orchestrator.flux_maps.exporting.machines import saturated_map
from tests.plugins.streams.report.example_diagnosis import a_diagnosis
from tests.support.tiny import MOTOR, tiny_document

WORDS = DiagnosisWords(where_it_fails="", what_it_looks_like="", likely_cause="", if_added="", to_decide="")
CAPABILITIES = Capabilities(
    name="simulated",
    sampling_frequency_hz=1e4,
    pwm_frequency_hz=8e3,
    pwm_frequencies_hz=(8e3,),
    dc_bus_voltage_v=540.0,
    voltage_delay_samples=1.0,
    max_current_a=9.0,
    max_voltage_v=300.0,
    excitations=frozenset({"gates_off"}),
    watchdog_s=0.2,
)


def a_run(
    folder: Path,
    *,
    r_s: float | None = 4.25,
    verdict: Verdict | None = "explained",
    judged: bool = True,
    accept: Mapping[str, Any] | None = None,
    about: Mapping[str, Any] | None = None,
    motor: Mapping[str, Any] | None = None,
    flux_map: FluxMap | None = None,
    outcome: str | None = "finished",
) -> Path:
    """A run in a new folder; without `r_s` it has no estimates, without a `verdict` no diagnosis."""
    document = tiny_document(motor={**MOTOR, **(motor or {})}) | {"about": dict(about or {})}
    procedure = Procedure.model_validate(document | ({} if accept is None else {"accept": dict(accept)}))
    run = RunDirectory.create(folder, procedure, CAPABILITIES)
    write_journal(run, outcome)
    if r_s is not None:
        report = estimates_of(r_s, judged=judged)
        found = flux_map or saturated_map(nodes=25, reach_a=3.0)
        write_results(report, {"energy": found}, folder / "results", motor="", recording=folder.name)
    if verdict is not None:
        save_diagnosis(folder, a_diagnosis(verdict=verdict, map_error_percent=0.3, ladder=()), WORDS, ())
    return folder


def write_journal(run: RunDirectory, outcome: str | None) -> None:
    messages: Sequence[Message] = [
        RunStarted(
            run=run.path.name,
            name="tiny",
            motor=run.record.procedure.motor,
            limits=Limits(current_a=5.0, voltage_v=100.0),
            drive="simulated",
            stages=1,
            points=1,
            points_done=0,
            seconds=1.0,
        )
    ]
    if outcome is not None:
        ended = RunEnded.model_validate({"outcome": outcome, "reason": "", "run": run.path.name})
        messages = [*messages, ended]
    with run.journal:
        for message in messages:
            run.journal.append(message)  # type: ignore[arg-type]  # both are journalled


def estimates_of(r_s: float, *, judged: bool = True) -> EstimationReport:
    """R_s within 10 mohm, and a map that is usable, or that nothing has judged yet."""
    check = UsabilityCheck(
        name="model",
        outcome=CheckOutcome.PASSED if judged else CheckOutcome.NOT_POSSIBLE,
        required=True,
        remark=Remark(code="model", text="a check"),
    )
    return EstimationReport(
        resistance=ResistanceEstimate(value_ohm=r_s, low=r_s - 0.01, high=r_s + 0.01, first_ohm=r_s, last_ohm=r_s),
        method="energy",
        crossings=None,
        parity=None,
        reciprocity_percent=None,
        classical_against_injection_percent=None,
        usable=judged,
        checks=(check,),
        maps={"energy": MapReport(checks=MapChecks())},
    )
