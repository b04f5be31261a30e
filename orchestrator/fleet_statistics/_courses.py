"""What moves over time or from batch to batch: slopes, shifts and control charts of each quantity."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from orchestrator.fleet_statistics._settings import FleetCriteria
from orchestrator.fleet_statistics._table import Column, FleetTable
from orchestrator.numerics.process_control import EwmaSettings, deviation_between_neighbours, ewma
from orchestrator.numerics.robust import Estimate, holm, shift, slope
from orchestrator.numerics.types import Array
from protocols.fleet_report import BatchShift, ChartPoint, ControlChart, Drift

DAY_S = 86400.0


def drifts(table: FleetTable, columns: Sequence[Column], criteria: FleetCriteria) -> dict[str, Drift]:
    """The slope of each quantity whose recordings have times."""
    found: dict[str, Estimate] = {}
    for column in columns:
        there = column.known & np.isfinite(table.seconds)
        days = table.seconds[there] / DAY_S
        if there.sum() >= criteria.least_values and np.ptp(days) > 0.0 and np.ptp(column.values[there]) > 0.0:
            found[column.name] = slope(days - days.min(), column.values[there])
    weighed = holm(np.array([one.chance for one in found.values()]))
    return {
        name: Drift(per_day=one.value, low=one.low, high=one.high, chance=one.chance, drifts=bool(p < criteria.chance))
        for (name, one), p in zip(found.items(), weighed, strict=True)
    }


def batch_shifts(
    table: FleetTable, columns: Sequence[Column], criteria: FleetCriteria
) -> dict[str, tuple[BatchShift, ...]]:
    """Each batch of each quantity against all others."""
    batches = np.array([recording.batch or "" for recording in table.recordings], dtype=object)
    found: list[tuple[str, str, Array, Estimate]] = []
    for column in columns:
        for batch in sorted({name for name in batches if name}):
            here, others = column.known & (batches == batch), column.known & (batches != batch)
            if min(here.sum(), others.sum()) >= criteria.least_values:
                values = column.values[here]
                found.append((column.name, batch, values, shift(values, column.values[others])))
    weighed = holm(np.array([one.chance for *_, one in found]))
    out: dict[str, tuple[BatchShift, ...]] = {}
    for (name, batch, values, one), p in zip(found, weighed, strict=True):
        told = BatchShift(
            batch=batch,
            count=len(values),
            middle=float(np.median(values)),
            shift=one.value,
            low=one.low,
            high=one.high,
            chance=one.chance,
            shifted=bool(p < criteria.chance),
        )
        out[name] = (*out.get(name, ()), told)
    return out


def control_chart(
    table: FleetTable, column: Column, criteria: FleetCriteria, settings: EwmaSettings | None = None
) -> ControlChart | None:
    """The chart of one quantity about its own median; None of too few recordings with times."""
    settings = settings or EwmaSettings()
    there = np.flatnonzero(column.known & np.isfinite(table.seconds))
    there = there[np.argsort(table.seconds[there], kind="stable")]
    values = column.values[there]
    deviation = deviation_between_neighbours(values)
    timed = len(values) >= criteria.least_values and np.ptp(table.seconds[there]) > 0.0
    if not timed or not deviation > 0.0 or not column.scatters(criteria.least_relative_spread):
        return None
    target = float(np.median(values))
    chart = ewma(values, target, deviation, settings)
    times = [datetime.fromtimestamp(s, UTC) for s in table.seconds[there]]
    first = int(np.argmax(chart.beyond)) if chart.beyond.any() else None
    points = []
    for group in np.array_split(np.arange(len(values)), min(len(values), criteria.most_points)):
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
