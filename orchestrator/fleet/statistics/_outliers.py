"""Outlying recordings and the quantities that make them so: jointly by robust distance, else quantity by quantity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from orchestrator.fleet.statistics._rows import name_of
from orchestrator.fleet.statistics._settings import FleetCriteria
from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.formatting.quantities import plural, quantity
from orchestrator.numerics.robust import spread
from orchestrator.numerics.robust_scatter import Scatter, robust_scatter
from orchestrator.numerics.types import Array, Mask
from protocols.fleet_report import DistancePoint, Distances, FleetOutlier, OutlierReason


def outliers(table: FleetTable, criteria: FleetCriteria) -> tuple[Distances | None, tuple[FleetOutlier, ...]]:
    """The distances, and the outlying recordings, the furthest first."""
    columns, scatter = _joint_scatter(table, criteria)
    distances: Distances | None = None
    reached: dict[int, tuple[float, float]] = {}
    reasons: dict[int, list[OutlierReason]] = {}
    if scatter is not None:
        rows = np.column_stack([column.values for column in columns])
        squares = scatter.squares(rows)
        known = np.maximum(np.isfinite(rows).sum(axis=1), 1)
        limits = scatter.limits(criteria.max_false_alarm / len(table), known)
        for k in np.flatnonzero(squares > limits).tolist():
            reached[k] = float(np.sqrt(squares[k])), float(np.sqrt(limits[k]))
            reasons[k] = _reasons(columns, scatter, rows[k], k, criteria)
        distances = Distances(
            quantities=tuple(column.name for column in columns),
            counted=int(scatter.counted.sum()),
            points=_thinned(np.sqrt(squares / limits), criteria),
        )
    single = [c for c in table.columns.values() if (c.of_motor or c.is_effect) and c not in columns]
    by_quantity = [outlier for column in single for outlier in _single_outliers(column, len(single), criteria)]
    for k, reason in sorted(by_quantity, key=lambda outlier: -abs(outlier[1].sigma or 0.0)):
        reasons.setdefault(k, []).append(reason)
    all_outliers = []
    for k, why in reasons.items():
        (distance, limit), recording = reached.get(k, (None, None)), table.recordings[k]
        text = f"{name_of(recording)}: {'; '.join(reason_words(reason, criteria) for reason in why)}"
        all_outliers.append(
            FleetOutlier(recording=recording, distance=distance, limit=limit, reasons=tuple(why), text=text)
        )
    return distances, tuple(sorted(all_outliers, key=_outlyingness, reverse=True))


def _joint_scatter(table: FleetTable, criteria: FleetCriteria) -> tuple[list[Column], Scatter | None]:
    """The quantities of the robust distance, in the table's order, and their scatter."""
    # Enough recordings have each, it scatters, enough complete rows remain, and it is no linear function of earlier
    # ones.
    chosen: list[Column] = []
    complete = np.ones(len(table), dtype=bool)
    for column in table.columns.values():
        if not column.of_motor or column.known.sum() < criteria.min_known_share * len(table):
            continue
        rows = complete & column.known
        suffices = rows.sum() >= max(criteria.min_rows_per_quantity * (len(chosen) + 1), len(table) // 2)
        if suffices and column.scatters(criteria.min_relative_spread) and not _is_dependent(column, chosen, rows):
            chosen.append(column)
            complete = rows
    while chosen:
        try:
            return chosen, robust_scatter(np.column_stack([c.values for c in chosen])[complete])
        except np.linalg.LinAlgError:
            chosen = chosen[:-1]
    return [], None


def _is_dependent(column: Column, others: Sequence[Column], rows: Mask) -> bool:
    """Whether a quantity is, to rounding, a linear function of the others."""
    if not others:
        return False
    design = np.column_stack([np.ones(int(rows.sum())), *(_standard(c.values[rows]) for c in others)])
    target = _standard(column.values[rows])
    residual = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    return bool(np.sum(residual**2) < 1e-10 * np.sum(target**2))


def _standard(values: Array) -> Array:
    return np.asarray((values - np.median(values)) / (np.std(values) or 1.0), dtype=np.float64)


def _reasons(
    columns: Sequence[Column], scatter: Scatter, row: Array, k: int, criteria: FleetCriteria
) -> list[OutlierReason]:
    parts = scatter.parts(row)
    shares = parts / parts.sum()
    sigmas = (row - scatter.middle) / np.sqrt(np.diag(scatter.covariance))
    reasons: list[OutlierReason] = []
    for place in np.argsort(-shares)[: criteria.max_reasons]:
        if sum(reason.share or 0.0 for reason in reasons) >= criteria.explained_share:
            break
        middle, share = float(scatter.middle[place]), float(shares[place])
        reasons.append(_reason(columns[place], k, float(sigmas[place]), middle, share))
    return reasons


def _single_outliers(column: Column, tests: int, criteria: FleetCriteria) -> Iterator[tuple[int, OutlierReason]]:
    """Recordings that one of so many tested quantities makes outliers: a rare effect, or a value far out."""
    from scipy.stats import t

    known = np.flatnonzero(column.known)
    observable = int(column.observable.sum())
    if column.is_effect and observable >= criteria.min_values and len(known) <= criteria.max_rare_share * observable:
        for k in known.tolist():
            if column.low[k] > 0.0 or column.high[k] < 0.0:
                yield k, _reason(column, k, None, None, None, found_in=len(known))
        return
    if len(known) < criteria.min_values:
        return
    values, errors = column.values[known], np.nan_to_num(column.deviations[known])
    middle, scale = float(np.median(values)), spread(values)
    # A value with a wider interval than most may lie further out.
    widened = np.sqrt(scale**2 + np.maximum(errors**2 - np.median(errors) ** 2, 0.0))
    if not column.scatters(criteria.min_relative_spread):
        return
    # The spread has the efficiency of a standard deviation of 0.37 times as many values.
    level = criteria.max_false_alarm / (len(known) * max(tests, 1))
    limit = float(t.isf(0.5 * level, 0.37 * (len(known) - 1)))
    for place, sigma in zip(known, (values - middle) / widened, strict=True):
        if abs(sigma) > limit:
            yield int(place), _reason(column, int(place), float(sigma), middle, None)


def _reason(
    column: Column,
    k: int,
    sigma: float | None,
    middle: float | None,
    share: float | None,
    found_in: int | None = None,
) -> OutlierReason:
    low, high = float(column.low[k]), float(column.high[k])
    has_interval = bool(np.isfinite([low, high]).all()) and middle is not None
    return OutlierReason(
        quantity=column.name,
        label=column.label,
        value=float(column.values[k]),
        unit=column.unit,
        sigma=sigma,
        share=share,
        found_in=found_in,
        sure=bool(not low <= float(middle or 0.0) <= high) if has_interval else None,
    )


def reason_words(reason: OutlierReason, criteria: FleetCriteria) -> str:
    """``phase resistance imbalance: extra b +4.1 sigma (52 mΩ)``."""
    value = quantity(reason.value, reason.unit)
    if reason.sigma is None:
        return f"{reason.label} {value}, in {plural(reason.found_in or 0, 'recording')} only"
    text = f"{reason.label} {reason.sigma:+.1f} sigma ({value})".replace("-", "−")
    if reason.share is not None and abs(reason.sigma) < criteria.min_outlier_sigma:
        text += ", unusual in combination with the others"
    return text + (", but its own interval contains the median" if reason.sure is False else "")


def _outlyingness(outlier: FleetOutlier) -> float:
    ratio = (outlier.distance or 0.0) / (outlier.limit or 1.0)
    return max(ratio, *(abs(reason.sigma or 0.0) * 0.1 for reason in outlier.reasons))


def _thinned(ratios: Array, criteria: FleetCriteria) -> tuple[DistancePoint, ...]:
    """All outliers, and the largest of each group of the others."""
    known = np.flatnonzero(np.isfinite(ratios))
    groups = np.array_split(known, max(1, min(len(known), criteria.max_points)))
    kept = {int(group[np.argmax(ratios[group])]) for group in groups if len(group)}
    kept |= {int(k) for k in known[ratios[known] > 1.0]}
    return tuple(DistancePoint(recording=k, ratio=float(ratios[k])) for k in sorted(kept))
