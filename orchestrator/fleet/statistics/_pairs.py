"""Motors measured twice: changes of each beyond its own intervals, and changes of all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.fleet.statistics._settings import FleetCriteria
from orchestrator.fleet.statistics._table import Column, FleetTable
from orchestrator.numerics.robust import Estimate, holm, paired_shift
from orchestrator.numerics.types import Array
from protocols import InputError
from protocols.fleet_report import FleetPairs, PairChange, PairedQuantity

WITHIN = "pairs"
"""Instead of a second table: each motor's first recording against its last."""


def pairs(after: FleetTable, before: FleetTable | None, criteria: FleetCriteria) -> FleetPairs:
    """Changes between two tables, by each motor's latest recording, or from first to last recording in one table.

    Parameters
    ----------
    before : FleetTable, optional
        None: first against last recording within ``after``.

    Raises
    ------
    InputError
        Where no motor was measured twice.
    """
    last, first = _by_serial(after), _by_serial(before if before is not None else after, latest=before is not None)
    both = [serial for serial in first if serial in last and (before is not None or first[serial] != last[serial])]
    against = before or after
    if not both:
        raise InputError(against.place, "serial", f"no serial number is measured twice with {after.place}")
    rows = (np.array([first[serial] for serial in both]), np.array([last[serial] for serial in both]))
    names = [name for name in after.columns if name in against.columns]
    quantities = [_Paired.of(against.columns[name], after.columns[name], rows) for name in names]
    compared = [q for q in quantities if q.column.of_motor or q.column.is_effect]
    return FleetPairs(
        against=WITHIN if before is None else before.place,
        count=len(both),
        unpaired=len({*first, *last}) - len(both),
        quantities=_shifts(compared, criteria),
        changes=_changes(compared, both, criteria),
    )


@dataclass(frozen=True)
class _Paired:
    """One quantity before and after; arrays of shape (pairs,)."""

    column: Column
    before: Array
    after: Array
    half_width: Array
    """Half width of the difference's 95 % interval; NaN where one of the two has none."""
    appeared: Array
    """1 where an effect appeared, -1 where one disappeared, both beyond its interval; 0 elsewhere."""

    @classmethod
    def of(cls, before: Column, after: Column, rows: tuple[Array, Array]) -> _Paired:
        first, last = rows[0].astype(int), rows[1].astype(int)
        widths = np.hypot(0.5 * (before.high - before.low)[first], 0.5 * (after.high - after.low)[last])
        clear = [(c.low > 0.0) | (c.high < 0.0) for c in (before, after)]
        appeared = (after.known & clear[1])[last] & ~before.known[first] & before.observable[first] & after.is_effect
        disappeared = (before.known & clear[0])[first] & ~after.known[last] & after.observable[last] & after.is_effect
        sign = appeared.astype(float) - disappeared.astype(float)
        return cls(after, before.values[first], after.values[last], widths, sign)

    @property
    def difference(self) -> Array:
        return self.after - self.before


def _shifts(compared: Sequence[_Paired], criteria: FleetCriteria) -> tuple[PairedQuantity, ...]:
    shifts: list[tuple[_Paired, int, Estimate]] = []
    for quantity in compared:
        finite = quantity.difference[np.isfinite(quantity.difference)]
        if len(finite) >= criteria.min_values:
            shifts.append((quantity, len(finite), paired_shift(finite)))
    adjusted = holm(np.array([estimate.chance for *_, estimate in shifts]))
    return tuple(
        PairedQuantity(
            name=quantity.column.name,
            label=quantity.column.label,
            unit=quantity.column.unit,
            count=count,
            shift=estimate.value,
            low=estimate.low,
            high=estimate.high,
            chance=estimate.chance,
            significant=bool(p < criteria.max_false_alarm),
        )
        for (quantity, count, estimate), p in zip(shifts, adjusted, strict=True)
    )


def _changes(compared: Sequence[_Paired], serials: Sequence[str], criteria: FleetCriteria) -> tuple[PairChange, ...]:
    from scipy.stats import norm

    if not compared:
        return ()
    sigmas = np.stack([np.abs(quantity.difference) / (quantity.half_width / norm.ppf(0.975)) for quantity in compared])
    adjusted = holm(2.0 * norm.sf(sigmas).ravel()).reshape(sigmas.shape)
    changes = []
    for place, quantity in enumerate(compared):
        for k in map(int, np.flatnonzero((adjusted[place] < criteria.max_false_alarm) | (quantity.appeared != 0.0))):
            half = quantity.half_width[k]
            changes.append(
                PairChange(
                    serial=serials[k],
                    quantity=quantity.column.name,
                    label=quantity.column.label,
                    unit=quantity.column.unit,
                    before=quantity.before[k],
                    after=quantity.after[k],
                    difference=quantity.difference[k],
                    low=quantity.difference[k] - half,
                    high=quantity.difference[k] + half,
                    significant=True,
                )
            )
    return tuple(sorted(changes, key=lambda change: change.serial))


def _by_serial(table: FleetTable, latest: bool = True) -> dict[str, int]:
    """The row of each serial number's latest recording, or its first; without times by their order in the table."""
    order = np.argsort(np.nan_to_num(table.seconds, nan=-np.inf), kind="stable")
    rows: dict[str, int] = {}
    for k in order if latest else order[::-1]:
        serial = table.recordings[k].serial
        if serial:
            rows[serial] = int(k)
    return dict(sorted(rows.items()))
