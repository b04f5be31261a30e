"""One run in a line: what it is of, how it ended and what was found, as the index keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path

from orchestrator.formatting.names import plain
from orchestrator.runs import JournalRecord, RunDirectory, last_end
from orchestrator.shelf.acceptance import judge_acceptance
from orchestrator.shelf.labels import load_labels
from orchestrator.shelf.results import RunResults, load_results
from protocols import FluxbenchError, RunLabels, RunStarted


@dataclass(frozen=True)
class RunFacts:
    """A run as the index has it; texts are empty and numbers None where unknown.

    Attributes
    ----------
    run : str
        Path of its folder below the folder of runs.
    outcome : str
        ``finished``, ``faulted``, ``aborted`` or ``not ended``; empty where `run.json` or the journal cannot be read.
    causes : str
        Names of the effects that the diagnosis reports.
    accepted : str
        ``pass`` or ``fail`` by the procedure's limits; empty where it has none, or the run has not finished.
    objections : str
        Why it was not accepted.
    resistance_ohm, resistance_low_ohm, resistance_high_ohm : float or None
        R_s with its 95 % interval; likewise L_dd and L_qq at zero current, and the flux at the rated current.
    duration_s : float or None
        Time at work by the wall clock, without pauses before a resumption.
    problem : str
        Error of a file that cannot be read.
    """

    run: str
    created: str = ""
    procedure: str = ""
    motor: str = ""
    outcome: str = ""
    serial: str = ""
    operator: str = ""
    ambient: str = ""
    instruments: str = ""
    tags: str = ""
    notes: str = ""
    drive: str = ""
    verdict: str = ""
    causes: str = ""
    accepted: str = ""
    objections: str = ""
    usability: str = ""
    resistance_ohm: float | None = None
    resistance_low_ohm: float | None = None
    resistance_high_ohm: float | None = None
    l_dd_h: float | None = None
    l_dd_low_h: float | None = None
    l_dd_high_h: float | None = None
    l_qq_h: float | None = None
    l_qq_low_h: float | None = None
    l_qq_high_h: float | None = None
    rated_flux_wb: float | None = None
    rated_flux_low_wb: float | None = None
    rated_flux_high_wb: float | None = None
    map_error_percent: float | None = None
    duration_s: float | None = None
    problem: str = ""

    @property
    def is_readable(self) -> bool:
        """Whether it can be listed: `run.json` and the journal are whole."""
        return self.outcome != ""


COLUMNS = tuple(field.name for field in fields(RunFacts))
NUMBERS = tuple(field.name for field in fields(RunFacts) if field.default is None)
QUANTITIES = ("resistance_ohm", "l_dd_h", "l_qq_h", "rated_flux_wb")
"""Columns that have an interval beside them."""


def interval_columns(quantity: str) -> tuple[str, str]:
    """Columns of the ends of a quantity's interval: ``l_dd_low_h`` and ``l_dd_high_h``."""
    name, _, unit = quantity.rpartition("_")
    return f"{name}_low_{unit}", f"{name}_high_{unit}"


def read_facts(folder: Path, name: str) -> RunFacts:
    """The facts of the run in a folder, under a name; errors of its files are in them, and never raised."""
    try:
        run = RunDirectory.open(folder)
        journal = run.journal.read()
    except FluxbenchError as error:
        return RunFacts(name, problem=str(error))
    procedure, about = run.record.procedure, run.record.procedure.about
    problems: list[str] = []
    labels, results = RunLabels.model_construct(tags=about.tags, notes=about.notes), RunResults()
    try:
        labels = load_labels(folder, about)
    except FluxbenchError as error:
        problems.append(str(error))
    try:
        results = load_results(folder, procedure.motor.rated_current_a)
    except FluxbenchError as error:
        problems.append(str(error))
    end = last_end(journal)
    outcome = "not ended" if end is None else end.outcome
    accepted = objections = ""
    if procedure.accept is not None and outcome == "finished":
        judged = judge_acceptance(procedure.accept, results)
        accepted, objections = "pass" if judged.passed else "fail", "; ".join(judged.objections)
    texts = dict(about.model_copy(update={"tags": labels.tags, "notes": labels.notes}).lines())
    numbers: dict[str, float | None] = {"duration_s": _duration_s(journal)}
    for quantity, interval in results.quantities.items():
        numbers[quantity] = interval.value
        if quantity in QUANTITIES:
            low, high = interval_columns(quantity)
            numbers |= {low: interval.low, high: interval.high}
    return RunFacts(
        run=name,
        created=run.record.created,
        procedure=procedure.name,
        motor=procedure.motor.name,
        outcome=outcome,
        drive=procedure.drive.name,
        verdict=results.verdict or "",
        causes=", ".join(map(plain, results.causes)),
        accepted=accepted,
        objections=objections,
        usability="" if results.usability is None else results.usability.value,
        problem="; ".join(problems),
        **texts,
        **numbers,
    )


def _duration_s(journal: Sequence[JournalRecord]) -> float | None:
    """Sum over the sessions, each from its start to the last record before the next start [s]."""
    starts = [k for k, record in enumerate(journal) if isinstance(record.message, RunStarted)]
    if not starts:
        return None
    try:
        times = [datetime.fromisoformat(record.t).timestamp() for record in journal]
    except ValueError:
        return None
    ends = [*(k - 1 for k in starts[1:]), len(journal) - 1]
    return sum(times[end] - times[start] for start, end in zip(starts, ends, strict=True))
