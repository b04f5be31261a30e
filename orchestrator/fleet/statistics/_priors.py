"""Priors for a fleet's next motor: frequency and size of each effect, R_s, L_d and L_q."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.fleet.statistics._settings import FleetCriteria
from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.numerics.between import population
from orchestrator.numerics.robust import spread
from orchestrator.validation.messages import suggestion
from protocols import InputError
from protocols.fleet_priors import EffectPrior, FleetPriors, NormalPrior


def priors_of(table: FleetTable, motor: str | None = None, criteria: FleetCriteria | None = None) -> FleetPriors:
    """Distributions over motors of one kind.

    An effect's probability follows Laplace's rule, (found + 1) / (diagnosed + 2). Recordings with an unexplained
    residual contribute neither frequencies nor sizes. Values far out are excluded: a fault is no property of the kind.

    Parameters
    ----------
    motor : str, optional
        The nameplate's name; needed where the table has several.

    Raises
    ------
    InputError
        Where the table has several and none is chosen, or too few recordings.
    """
    criteria = criteria or FleetCriteria()
    table = _of_kind(table, motor)
    explained = np.array([verdict in criteria.explained_verdicts for verdict in table.verdicts], dtype=bool)
    count = int(explained.sum())
    if count < criteria.min_values:
        problem = f"{count} diagnosed and explained recordings of one kind of motor; expected {criteria.min_values}"
        raise InputError(table.place, "verdict", f"{problem} or more")
    explained_table = table.of_rows(explained)
    effects: dict[str, EffectPrior] = {}
    for name in dict.fromkeys(c.name.partition(".")[0] for c in explained_table.columns.values() if c.is_effect):
        columns = [c for c in explained_table.columns.values() if c.is_effect and c.name.startswith(f"{name}.")]
        present = int(np.any([c.known for c in columns], axis=0).sum())
        sizes = {c.name.partition(".")[2]: prior for c in columns if (prior := _normal(c, criteria)) is not None}
        if present:
            probability = (present + 1) / (count + 2)
            effects[name] = EffectPrior(probability=probability, found=present, asked=count, sizes=sizes)
    r_s, l_d, l_q = (_normal(table.columns[name], criteria) for name in ("R_s_ohm", "L_d_h", "L_q_h"))
    kind = next((name for name in table.motors if name is not None), None)
    return FleetPriors(
        motor=kind,
        table=table.place,
        recordings=len(table),
        diagnosed=count,
        resistance=r_s,
        d_inductance=l_d,
        q_inductance=l_q,
        effects=effects,
    )


def _of_kind(table: FleetTable, motor: str | None) -> FleetTable:
    kinds: Sequence[str] = sorted({name for name in table.motors if name is not None})
    if motor is None and len(kinds) > 1:
        raise InputError(table.place, "motor", f"{len(kinds)} kinds of motor: choose one by --motor", kinds)
    if motor is not None and motor not in kinds:
        raise InputError(table.place, "motor", f"no {motor!r}; {suggestion(motor, kinds)}")
    return table if motor is None else table.of_rows(np.array([name == motor for name in table.motors], dtype=bool))


def _normal(column: Column, criteria: FleetCriteria) -> NormalPrior | None:
    """The population behind a quantity; None where values are too few or all the same."""
    values, errors = column.values[column.known], np.nan_to_num(column.deviations[column.known])
    if len(values) < criteria.min_values:
        return None
    off = np.abs(values - np.median(values))
    inside = off <= criteria.max_robust_sigmas * np.hypot(spread(values), errors)
    if inside.sum() < criteria.min_values or not np.ptp(values[inside]) > 0.0:
        return None
    estimate = population(values[inside], errors[inside])
    return NormalPrior(mean=estimate.mean, std=estimate.std, unit=column.unit, recordings=int(inside.sum()))
