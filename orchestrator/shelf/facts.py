"""One run in a line: what it is of, how it ended and what was found, as the index keeps it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import UNKNOWN, duration, percent, quantity, value_and_interval
from orchestrator.runs import JournalRecord, RunDirectory, last_end
from orchestrator.shelf.acceptance import UNITS, judge_acceptance
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


def with_intervals(columns: Iterable[str]) -> tuple[str, ...]:
    """Columns, and after each quantity those of its interval."""
    return tuple(
        name
        for column in columns
        for name in ((column, *interval_columns(column)) if column in QUANTITIES else (column,))
    )


def is_text(column: str) -> bool:
    """Whether a column holds texts."""
    return column not in NUMBERS


def cells(facts: RunFacts, columns: Sequence[str]) -> tuple[str, ...]:
    """Values of a run in print, quantities with as many digits as their interval supports."""
    return tuple(_cell(facts, column) for column in columns)


def _cell(facts: RunFacts, column: str) -> str:
    value = getattr(facts, column)
    if column not in NUMBERS:
        return str(value)
    if value is None:
        return UNKNOWN
    if column in QUANTITIES:
        low, high = (getattr(facts, name) for name in interval_columns(column))
        return value_and_interval(value, low, high, UNITS[column])[0]
    if column == "duration_s":
        return duration(value)
    return percent(value) if column == "map_error_percent" else quantity(value, _unit_of(column), 4)


def _unit_of(column: str) -> str:
    return {"ohm": "ohm", "h": "H", "wb": "Wb"}[column.rpartition("_")[2]]


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
    others: dict[str, Any] = dict(about.model_copy(update={"tags": labels.tags, "notes": labels.notes}).lines())
    for name_of, interval in results.quantities.items():
        others[name_of] = interval.value
        if name_of in QUANTITIES:
            low, high = interval_columns(name_of)
            others |= {low: interval.low, high: interval.high}
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
        duration_s=_duration_s(journal),
        problem="; ".join(problems),
        **others,
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
