"""Changes over time or between batches: slopes, shifts and control charts of each quantity."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from orchestrator.fleet.statistics._settings import FleetCriteria
from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.numerics.process_control import EwmaSettings, deviation_between_neighbours, ewma
from orchestrator.numerics.robust import Estimate, holm, shift, slope
from orchestrator.numerics.types import Array
from protocols.fleet_report import BatchShift, ChartPoint, ControlChart, Drift

DAY_S = 86400.0


def drifts(table: FleetTable, columns: Sequence[Column], criteria: FleetCriteria) -> dict[str, Drift]:
    """The slope of each quantity whose recordings have times."""
    estimates: dict[str, Estimate] = {}
    for column in columns:
        timed = column.known & np.isfinite(table.seconds)
        days = table.seconds[timed] / DAY_S
        if timed.sum() >= criteria.min_values and np.ptp(days) > 0.0 and np.ptp(column.values[timed]) > 0.0:
            estimates[column.name] = slope(days - days.min(), column.values[timed])
    adjusted = holm(np.array([estimate.chance for estimate in estimates.values()]))
    return {
        name: Drift(per_day=e.value, low=e.low, high=e.high, chance=e.chance, drifts=bool(p < criteria.max_false_alarm))
        for (name, e), p in zip(estimates.items(), adjusted, strict=True)
    }


def batch_shifts(
    table: FleetTable, columns: Sequence[Column], criteria: FleetCriteria
) -> dict[str, tuple[BatchShift, ...]]:
    """Each batch of each quantity against all others."""
    batches = np.array([recording.batch or "" for recording in table.recordings], dtype=object)
    estimates: list[tuple[str, str, Array, Estimate]] = []
    for column in columns:
        for batch in sorted({name for name in batches if name}):
            here, others = column.known & (batches == batch), column.known & (batches != batch)
            if min(here.sum(), others.sum()) >= criteria.min_values:
                values = column.values[here]
                estimates.append((column.name, batch, values, shift(values, column.values[others])))
    adjusted = holm(np.array([estimate.chance for *_, estimate in estimates]))
    out: dict[str, tuple[BatchShift, ...]] = {}
    for (name, batch, values, estimate), p in zip(estimates, adjusted, strict=True):
        batch_shift = BatchShift(
            batch=batch,
            count=len(values),
            middle=float(np.median(values)),
            shift=estimate.value,
            low=estimate.low,
            high=estimate.high,
            chance=estimate.chance,
            shifted=bool(p < criteria.max_false_alarm),
        )
        out[name] = (*out.get(name, ()), batch_shift)
    return out


def control_chart(
    table: FleetTable, column: Column, criteria: FleetCriteria, settings: EwmaSettings | None = None
) -> ControlChart | None:
    """The control chart of one quantity about its own median; None where too few recordings have times."""
    settings = settings or EwmaSettings()
    rows = np.flatnonzero(column.known & np.isfinite(table.seconds))
    rows = rows[np.argsort(table.seconds[rows], kind="stable")]
    values = column.values[rows]
    deviation = deviation_between_neighbours(values)
    timed = len(values) >= criteria.min_values and np.ptp(table.seconds[rows]) > 0.0
    if not timed or not deviation > 0.0 or not column.scatters(criteria.min_relative_spread):
        return None
    target = float(np.median(values))
    chart = ewma(values, target, deviation, settings)
    times = [datetime.fromtimestamp(s, UTC) for s in table.seconds[rows]]
    first = int(np.argmax(chart.beyond)) if chart.beyond.any() else None
    points = []
    for group in np.array_split(np.arange(len(values)), min(len(values), criteria.max_points)):
        k = int(group[np.argmax(np.abs(chart.average[group] - target))])
        points.append(
            ChartPoint(
                at=times[k],
                value=float(np.median(values[group])),
                average=float(chart.average[k]),
                lower=float(chart.lower[k]),
                upper=float(chart.upper[k]),
            )
        )
    return ControlChart(
        target=target,
        deviation=deviation,
        weight=settings.weight,
        width=settings.width,
        beyond=int(chart.beyond.sum()),
        first_beyond=None if first is None else times[first],
        points=tuple(points),
    )
