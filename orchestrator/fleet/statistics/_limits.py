"""A fleet compared with a user's file of limits: each recording passes, fails or remains undecided."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.formatting.quantities import measured, quantity
from orchestrator.numerics.process_control import capability, share_beyond
from orchestrator.validation.messages import first_problem, nearest, suggestion
from orchestrator.validation.strict_yaml import read_document
from protocols import InputError
from protocols.fleet_report import CapabilityIndex, FleetJudgement, FleetLimit, FleetLimits, Judgement, NotPassed

_SEVERITY: tuple[Judgement, ...] = ("pass", "unsure", "not_measured", "fail")


def read_limits(path: Path) -> FleetLimits:
    """Read a file of limits.

    Raises
    ------
    InputError
        One line: file and line, key, what is wrong, the nearest valid name.
    """
    document = read_document(path)
    try:
        return FleetLimits.model_validate(document.data)
    except ValidationError as error:
        problem = first_problem(error, FleetLimits, document.data)
        raise InputError(document.place(problem.path), problem.field, problem.text) from None


def require_known(limits: FleetLimits, place: str, table: FleetTable, effects: Iterable[str] = ()) -> None:
    """Raise `InputError` where a limit names a quantity that neither table nor library has.

    Parameters
    ----------
    place : str
        The file of the limits.
    effects : iterable of str
        ``effect.parameter`` of the library's effects.
    """
    known = {*table.columns, *effects}
    for name in limits.quantities:
        if name not in known:  # the library's names would make a long line
            near = nearest(name, sorted(known))
            hint = f"did you mean {near!r}?" if near is not None else suggestion(name, table.columns)
            raise InputError(place, f"quantities.{name}", f"unknown quantity; {hint}")


def judge(table: FleetTable, limits: FleetLimits) -> FleetJudgement:
    """Every recording with results against the limits; one that could not be measured does not pass."""
    counts: dict[Judgement, int] = dict.fromkeys(_SEVERITY, 0)
    not_passed = []
    for k, recording in enumerate(table.recordings):
        checks = list(_checks(table, limits, k))
        worst: Judgement = max((judgement for judgement, _ in checks), key=_SEVERITY.index, default="pass")
        counts[worst] += 1
        if worst != "pass":
            reasons = tuple(text for judgement, text in checks if judgement != "pass")
            not_passed.append(NotPassed(recording=recording, judgement=worst, reasons=reasons))
    not_passed.sort(key=lambda recording: -_SEVERITY.index(recording.judgement))
    return FleetJudgement(
        limits=limits,
        passed=counts["pass"],
        failed=counts["fail"],
        unsure=counts["unsure"],
        not_measured=counts["not_measured"],
        others=tuple(not_passed),
    )


def capability_of(column: Column, limit: FleetLimit) -> CapabilityIndex | None:
    """The process capability of a quantity; None where no recording has it."""
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


def _checks(table: FleetTable, limits: FleetLimits, k: int) -> Iterator[tuple[Judgement, str]]:
    for name, limit in limits.quantities.items():
        yield _check_value(table, name, limit, k, limits.guard)
    if limits.verdicts is not None:
        verdict = table.verdicts[k]
        if verdict is None:
            yield "not_measured", "not diagnosed"
        elif verdict not in limits.verdicts:
            yield "fail", f"verdict {verdict}"
    if limits.usable and table.usable[k] is not True:
        yield ("fail", "map not reliable") if table.usable[k] is False else ("not_measured", "no map that is judged")


def _check_value(table: FleetTable, name: str, limit: FleetLimit, k: int, guard: bool) -> tuple[Judgement, str]:
    column = table.columns.get(name)
    if column is None or not column.known[k]:
        observable = table.verdicts[k] is not None if column is None else column.is_effect and column.observable[k]
        label = name if column is None else column.label
        if not observable:
            return "not_measured", f"{label} not measured"
        # An effect that was searched for and not found has size zero, which limits need not allow.
        return ("fail", f"{label} not found") if _beyond(0.0, 0.0, limit) else ("pass", "")
    value = float(column.values[k])
    low, high = (float(column.low[k]), float(column.high[k])) if guard else (value, value)
    low, high = (low, high) if np.isfinite([low, high]).all() else (value, value)
    worst: Judgement = "fail" if _beyond(low, high, limit, entirely=True) else "pass"
    if worst == "pass" and _beyond(low, high, limit):
        worst = "unsure"
    text = measured(value, low, high, column.unit) if high > low else quantity(value, column.unit, 4)
    ends = [f"below {quantity(limit.low, column.unit, 4)}" if limit.low is not None and low < limit.low else ""]
    ends.append(f"above {quantity(limit.high, column.unit, 4)}" if limit.high is not None and high > limit.high else "")
    return worst, f"{column.label} {text} {'may be ' * (worst == 'unsure')}{' and '.join(filter(None, ends))}"


def _beyond(low: float, high: float, limit: FleetLimit, entirely: bool = False) -> bool:
    """Whether an interval leaves the limits, in part or entirely."""
    lower, upper = (high, low) if entirely else (low, high)
    return (limit.low is not None and lower < limit.low) or (limit.high is not None and upper > limit.high)
