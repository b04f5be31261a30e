"""The report of a fleet's table, computed once; page, terminal and viewer only show it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime

import numpy as np

from orchestrator.fleet.statistics._limits import capability_of, judge
from orchestrator.fleet.statistics._outliers import outliers
from orchestrator.fleet.statistics._pairs import pairs
from orchestrator.fleet.statistics._settings import FleetCriteria
from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.fleet.statistics._trends import batch_shifts, control_chart, drifts
from orchestrator.formatting.quantities import measured, number, plural
from orchestrator.numerics.robust import spread
from orchestrator.numerics.types import Array
from protocols import InputError, Remark
from protocols.fleet_report import CountOf, FleetLimits, FleetQuantity, FleetReport, Histogram, Quantile


def report_of(
    table: FleetTable,
    *,
    limits: FleetLimits | None = None,
    against: FleetTable | None = None,
    within: bool = False,
    criteria: FleetCriteria | None = None,
) -> FleetReport:
    """Distributions, outliers, drift, batches, control charts, compliance with limits, and changes of pairs.

    Parameters
    ----------
    against : FleetTable, optional
        An earlier table of the same motors.
    within : bool
        Compare each motor's first recording with its last.

    Raises
    ------
    InputError
        Where no recording has results, or no motor was measured twice although pairs are requested.
    """
    criteria = criteria or FleetCriteria()
    if not len(table):
        raise InputError(table.place, "", "no recording has results")
    columns = [column for column in table.columns.values() if column.known.any()]
    drift, shifts = drifts(table, columns, criteria), batch_shifts(table, columns, criteria)
    quantities = tuple(
        _quantity(table, column, limits, criteria).model_copy(
            update={"drift": drift.get(column.name), "batches": shifts.get(column.name, ())}
        )
        for column in columns
    )
    distances, outlying = outliers(table, criteria)
    times = table.seconds[np.isfinite(table.seconds)]
    report = FleetReport(
        table=table.place,
        recordings=len(table),
        serials=len({r.serial for r in table.recordings if r.serial}),
        first=datetime.fromtimestamp(times.min(), UTC) if len(times) else None,
        last=datetime.fromtimestamp(times.max(), UTC) if len(times) else None,
        verdicts=_counts(verdict or "not diagnosed" for verdict in table.verdicts),
        failures=_counts(table.failures),
        damaged=tuple(table.damaged) + (() if against is None else tuple(against.damaged)),
        quantities=quantities,
        distances=distances,
        outliers=outlying,
        judgement=None if limits is None else judge(table, limits),
        pairs=pairs(table, against, criteria) if within or against is not None else None,
    )
    return report.model_copy(update={"remarks": tuple(_remarks(report))})


def _quantity(table: FleetTable, column: Column, limits: FleetLimits | None, criteria: FleetCriteria) -> FleetQuantity:
    values = np.sort(column.values[column.known])
    enough = len(values) >= criteria.min_values
    limit = None if limits is None else limits.quantities.get(column.name)
    half = 0.5 * (column.high - column.low)
    return FleetQuantity(
        name=column.name,
        label=column.label,
        unit=column.unit,
        count=len(values),
        asked=int(column.observable.sum()),
        of_motor=column.of_motor,
        middle=float(np.median(values)),
        spread=spread(values) if enough else None,
        typical_interval=float(np.nanmedian(half)) if np.isfinite(half).any() else None,
        quantiles=_quantiles(values, criteria) if enough else (),
        histogram=_histogram(values, criteria) if enough and column.scatters(criteria.min_relative_spread) else None,
        chart=control_chart(table, column, criteria),
        capability=None if limit is None else capability_of(column, limit),
    )


def _quantiles(values: Array, criteria: FleetCriteria) -> tuple[Quantile, ...]:
    quantiles = np.quantile(values, criteria.quantiles)
    return tuple(Quantile(share=s, value=float(v)) for s, v in zip(criteria.quantiles, quantiles, strict=True))


def _histogram(values: Array, criteria: FleetCriteria) -> Histogram | None:
    """Bins by the rule of Freedman and Diaconis (1981, doi:10.1007/BF01025868); outliers count in the end bins."""
    lower, upper = np.quantile(values, (0.25, 0.75))
    across = upper - lower
    low, high = max(values[0], lower - 3.0 * across), min(values[-1], upper + 3.0 * across)
    if not high > low:
        return None
    bins = int(np.ceil((high - low) / (2.0 * across / len(values) ** (1.0 / 3.0)))) if across > 0.0 else 1
    counts, edges = np.histogram(np.clip(values, low, high), bins=min(max(bins, 1), criteria.max_bins))
    return Histogram(edges=tuple(map(float, edges)), counts=tuple(map(int, counts)))


def _counts(words: Iterable[str]) -> tuple[CountOf, ...]:
    return tuple(CountOf(what=what, count=count) for what, count in Counter(words).most_common())


def _remarks(report: FleetReport) -> list[Remark]:
    """The report's main results as remarks."""
    remarks = []
    if report.damaged:
        text = "{what} of the table cannot be read, and their recordings are missing here: {first}"
        what = plural(len(report.damaged), "part")
        remarks.append(Remark.of("damaged", text, what=what, first=report.damaged[0]))
    if report.failures:
        count = sum(one.count for one in report.failures)
        text = "{what} without results, most often: {why}"
        remarks.append(Remark.of("failed", text, what=plural(count, "recording"), why=report.failures[0].what))
    if report.judgement is not None:
        result = report.judgement
        text = (
            "{passed} of {all} pass; {failed} fail, {unsure} are undecided within their intervals, {rest} not measured"
        )
        counts = {"failed": result.failed, "unsure": result.unsure, "rest": result.not_measured}
        remarks.append(Remark.of("judged", text, passed=result.passed, all=report.recordings, **counts))
    for one in (one for one in report.quantities if one.of_motor):
        if one.drift is not None and one.drift.drifts:
            rate = measured(one.drift.per_day, one.drift.low, one.drift.high, one.unit)
            remarks.append(Remark.of("drift", "{label} drifts by {rate} a day", label=one.label, rate=rate))
        for batch in one.batches:
            if batch.shifted:
                shift = measured(batch.shift, batch.low, batch.high, one.unit)
                text = "batch {batch}: {label} differs from the other batches by {shift}"
                remarks.append(Remark.of("batch", text, batch=batch.batch, label=one.label, shift=shift))
        if one.capability is not None and one.capability.cpk_high is not None and one.capability.cpk_high < 1.0:
            text = "{label}: Cpk {cpk}, at most {high}: three sigma do not fit between the limits"
            figures = {"cpk": number(one.capability.cpk, 3), "high": number(one.capability.cpk_high, 3)}
            remarks.append(Remark.of("capability", text, label=one.label, **figures))
    if report.distances is None:
        text = "too few complete recordings for a robust distance: each quantity was tested by itself"
        remarks.append(Remark.of("no_distance", text))
    if report.outliers:
        text = "outliers: {what}, first {text}"
        remarks.append(
            Remark.of("outliers", text, what=plural(len(report.outliers), "recording"), text=report.outliers[0].text)
        )
    else:
        remarks.append(Remark.of("no_outliers", "no recording is an outlier"))
    if report.pairs is not None:
        changes = report.pairs.changes
        if changes:
            motors = plural(len({change.serial for change in changes}), "motor")
            text = "{what} changed by more than the recordings' intervals, first serial {serial}: {label}"
            remarks.append(
                Remark.of("changed_motors", text, what=motors, serial=changes[0].serial, label=changes[0].label)
            )
        for quantity_ in report.pairs.quantities:
            if quantity_.significant:
                shift = measured(quantity_.shift, quantity_.low, quantity_.high, quantity_.unit)
                text = "from before to after, {label} changed by {shift} over {count} motors"
                remarks.append(Remark.of("changed", text, label=quantity_.label, shift=shift, count=quantity_.count))
    return remarks
