"""A fleet against limits of somebody's own file: each recording passes, fails, or cannot be told."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from orchestrator._document import parse_document
from orchestrator._validation import first_problem, nearest, suggestion
from orchestrator.fleet_statistics._table import Column, FleetTable
from orchestrator.formatting.quantities import measured, quantity
from orchestrator.numerics.process_control import capability, share_beyond
from orchestrator.plain_files import read_text
from protocols import InputError
from protocols.fleet_report import (
    CapabilityIndex,
    FleetJudgement,
    FleetLimit,
    FleetLimits,
    Judgement,
    NotPassed,
)

_WORSE: tuple[Judgement, ...] = ("pass", "unsure", "not_measured", "fail")


def read_limits(path: Path) -> FleetLimits:
    """Read a file of limits.

    Raises
    ------
    InputError
        One line: file and line, key, what is wrong, the nearest valid name.
    """
    try:
        text = read_text(path)
    except UnicodeDecodeError as error:
        raise InputError(str(path), "", f"not UTF-8 at byte {error.start}") from None
    except OSError as error:
        raise InputError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    document = parse_document(text, str(path))
    try:
        return FleetLimits.model_validate(document.data)
    except ValidationError as error:
        problem = first_problem(error, FleetLimits, document.data)
        raise InputError(document.place(problem.path), problem.field, problem.text) from None


def require_known(limits: FleetLimits, place: str, table: FleetTable, effects: Iterable[str] = ()) -> None:
    """Raise `InputError` where a limit is of something that neither table nor library has.

    Parameters
    ----------
    place : str
        Where the limits were written.
    effects : iterable of str
        ``effect.parameter`` of those that could have been found.
    """
    known = {*table.columns, *effects}
    for name in limits.quantities:
        if name not in known:  # all that the library has would be a long line
            near = nearest(name, sorted(known))
            told = f"did you mean {near!r}?" if near is not None else suggestion(name, table.columns)
            raise InputError(place, f"quantities.{name}", f"unknown quantity; {told}")


def judged(table: FleetTable, limits: FleetLimits) -> FleetJudgement:
    """Every recording with results against the limits; what could not be measured did not pass."""
    counts: dict[Judgement, int] = dict.fromkeys(_WORSE, 0)
    others = []
    for k, recording in enumerate(table.recordings):
        said = list(_said(table, limits, k))
        worst: Judgement = max((judgement for judgement, _ in said), key=_WORSE.index, default="pass")
        counts[worst] += 1
        if worst != "pass":
            reasons = tuple(text for judgement, text in said if judgement != "pass")
            others.append(NotPassed(recording=recording, judgement=worst, reasons=reasons))
    others.sort(key=lambda one: -_WORSE.index(one.judgement))
    return FleetJudgement(
        limits=limits,
        passed=counts["pass"],
        failed=counts["fail"],
        unsure=counts["unsure"],
        not_measured=counts["not_measured"],
        others=tuple(others),
    )


def capability_of(column: Column, limit: FleetLimit) -> CapabilityIndex | None:
    """How far inside its limits a quantity is as a whole; None where no recording has it."""
    values = column.values[column.known]
    if not len(values):
        return None
    index = capability(values, limit.low, limit.high)
    beyond = sum(_beyond(float(value), float(value), limit) for value in values)
    low, high = share_beyond(beyond, len(values))
    return CapabilityIndex(
        low=limit.low,
        high=limit.high,
        cpk=None if index is None else index.value,
        cpk_low=None if index is None else index.low,
        cpk_high=None if index is None else index.high,
        beyond=beyond,
        beyond_low=low,
        beyond_high=high,
    )


def _said(table: FleetTable, limits: FleetLimits, k: int) -> Iterator[tuple[Judgement, str]]:
    for name, limit in limits.quantities.items():
        yield _of_value(table, name, limit, k, limits.guard)
    if limits.verdicts is not None:
        verdict = table.verdicts[k]
        if verdict is None:
            yield "not_measured", "not diagnosed"
        elif verdict not in limits.verdicts:
            yield "fail", f"verdict {verdict}"
    if limits.usable and table.usable[k] is not True:
        told: tuple[Judgement, str] = ("fail", "map not to be relied on")
        yield told if table.usable[k] is False else ("not_measured", "no map")


def _of_value(table: FleetTable, name: str, limit: FleetLimit, k: int, guard: bool) -> tuple[Judgement, str]:
    column = table.columns.get(name)
    if column is None or not column.known[k]:
        looked = table.verdicts[k] is not None if column is None else column.is_effect and column.asked[k]
        label = name if column is None else column.label
        if not looked:
            return "not_measured", f"{label} not measured"
        # Looked for and not found: it is not there, which limits need not allow.
        return ("fail", f"{label} not found") if _beyond(0.0, 0.0, limit) else ("pass", "")
    value = float(column.values[k])
    low, high = (float(column.low[k]), float(column.high[k])) if guard else (value, value)
    low, high = (low, high) if np.isfinite([low, high]).all() else (value, value)
    worst: Judgement = "fail" if _beyond(low, high, limit, wholly=True) else "pass"
    if worst == "pass" and _beyond(low, high, limit):
        worst = "unsure"
    told = measured(value, low, high, column.unit) if high > low else quantity(value, column.unit, 4)
    ends = [f"below {quantity(limit.low, column.unit, 4)}" if limit.low is not None and low < limit.low else ""]
    ends.append(f"above {quantity(limit.high, column.unit, 4)}" if limit.high is not None and high > limit.high else "")
    return worst, f"{column.label} {told} {'may be ' * (worst == 'unsure')}{' and '.join(filter(None, ends))}"


def _beyond(low: float, high: float, limit: FleetLimit, wholly: bool = False) -> bool:
    """Whether an interval leaves the limits, in part or altogether."""
    nearest, furthest = (high, low) if wholly else (low, high)
    return (limit.low is not None and nearest < limit.low) or (limit.high is not None and furthest > limit.high)
