"""Check a segment's time stamps for missing samples, gaps and uneven spacing; resample where the mapping requests it.

Voltages are held between samples, so they are resampled by their integral (volt-seconds are kept); everything else is
interpolated linearly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._findings import Finding, Findings
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._source import Numbers
from orchestrator.importing._splitting import RawSegment
from orchestrator.importing._units import FACTORS, unit_that_fits
from protocols import InputError

MIN_STRETCH_SAMPLES = 10
"""Shorter stretches are left out: they contain too little information."""

_PART_ROWS = 1 << 19
"""Longer stretches are processed in parts, to limit the memory."""
_GAP = 1.5
"""Smallest step that counts as a gap [samples]."""
_PLAUSIBLE_RATE_HZ = (200.0, 5e6)


Rows = range | NDArray[np.intp]
"""Indices of rows in order; a range where none is missing."""


@dataclass(frozen=True)
class Stretch:
    """Rows of a segment without a gap: indices into the segment, and whether they need resampling."""

    rows: Rows
    uneven: bool

    @property
    def part(self) -> slice | NDArray[np.intp]:
        """The rows as a slice where they are consecutive, which avoids a copy."""
        first, last = int(self.rows[0]), int(self.rows[-1])
        if isinstance(self.rows, range) or last - first + 1 == len(self.rows):
            return slice(first, last + 1)
        return self.rows

    def parts(self) -> list[Stretch]:
        """The stretch in parts for processing; whole where it needs resampling."""
        if self.uneven:
            return [self]
        return [Stretch(self.rows[k : k + _PART_ROWS], False) for k in range(0, len(self.rows), _PART_ROWS)]


class Clock:
    """Determines the sampling frequency from the first segment and checks every later segment against it."""

    def __init__(self, mapping: ImportMapping, findings: Findings) -> None:
        self._findings = findings
        self._rate_hz = mapping.sampling_frequency_hz

    @property
    def rate_hz(self) -> float:
        """The recording's sampling frequency, known after the first segment."""
        assert self._rate_hz is not None
        return self._rate_hz

    def stretches(self, raw: RawSegment) -> Iterator[Stretch]:
        """The segment's uninterrupted stretches; raises `InputError` where gaps or uneven stamps are not allowed."""
        complete = self._complete_rows(raw)
        self._findings.dropped_rows["a value is missing"] += raw.time_s.size - len(complete)
        if len(complete) < MIN_STRETCH_SAMPLES:
            self._too_short(raw, len(complete))
            return
        time_s = raw.time_s if isinstance(complete, range) else raw.time_s[complete]
        self._check_increasing(raw, complete, time_s)
        self._learn_rate(raw, time_s)
        for start, end in self._between_gaps(raw, complete, time_s):
            if end - start < MIN_STRETCH_SAMPLES:
                self._too_short(raw, end - start)
                continue
            yield Stretch(complete[start:end], self._is_uneven(raw, complete[start:end], time_s[start:end]))

    def _complete_rows(self, raw: RawSegment) -> Rows:
        finite = np.isfinite(raw.time_s)
        for name, values in ((_time_column(raw), raw.time_s), *raw.columns.items()):
            here = np.isfinite(values)
            if not here.all() and not raw.mapping.split_at_gaps:
                row = int(np.argmin(here))
                missing = int(here.size - np.count_nonzero(here))
                raise InputError(
                    str(raw.path),
                    name,
                    f"{at(raw, row)} has no finite value, the first of {missing} such rows in the segment; "
                    "split_at_gaps: true ends a segment there and begins another",
                )
            finite &= here
        return range(finite.size) if finite.all() else np.flatnonzero(finite)

    def _check_increasing(self, raw: RawSegment, rows: Rows, time_s: Numbers) -> None:
        back = np.flatnonzero(time_s[1:] <= time_s[:-1])
        if back.size:
            worst = int(back[0])
            raise InputError(
                str(raw.path),
                _time_column(raw),
                f"time does not increase: {at(raw, rows[worst + 1])} is {time_s[worst] - time_s[worst + 1]:.3g} s "
                "before the row above",
            )

    def _learn_rate(self, raw: RawSegment, time_s: Numbers) -> None:
        column = raw.mapping.time
        if column is None:
            return
        steps = np.diff(time_s)
        period_s = float(np.median(steps, overwrite_input=True))
        if self._rate_hz is not None:
            self._check_unit(raw, column.unit, period_s, (0.5 / self._rate_hz, 2.0 / self._rate_hz))
            return
        low, high = _PLAUSIBLE_RATE_HZ
        self._check_unit(raw, column.unit, period_s, (1.0 / high, 1.0 / low))
        steady = steps < _GAP * period_s
        # Among rates within a twentieth of a sample over the whole segment, the roundest is the intended one.
        self._rate_hz = _roundest(1.0 / float(np.mean(steps, where=steady)), 0.05 / np.count_nonzero(steady))

    def _check_unit(self, raw: RawSegment, unit: str, period_s: float, plausible: tuple[float, float]) -> None:
        if plausible[0] <= period_s <= plausible[1]:
            return
        fits = unit_that_fits(unit, period_s, *plausible)
        hint = "" if fits is None else f"; {fits} would give {1 / (period_s * FACTORS[fits] / FACTORS[unit]):.6g} Hz"
        expected = "" if self._rate_hz is None else f", not {self._rate_hz:g} Hz"
        self._findings.doubt(
            Finding.TIME_UNIT,
            str(raw.path),
            _time_column(raw),
            f"read in {unit}, the time stamps make {1 / period_s:.6g} Hz{expected}{hint}",
        )

    def _between_gaps(self, raw: RawSegment, rows: Rows, time_s: Numbers) -> Sequence[tuple[int, int]]:
        steps = np.diff(time_s)
        gaps = np.flatnonzero(steps > _GAP / self.rate_hz)
        if gaps.size and not raw.mapping.split_at_gaps:
            first = int(gaps[0])
            raise InputError(
                str(raw.path),
                _time_column(raw),
                f"{steps[first]:.3g} s without a sample before {at(raw, rows[first + 1])}, "
                f"{gaps.size} such in the segment; split_at_gaps: true ends a segment there and begins another",
            )
        if gaps.size:
            self._findings.note("gap", f"{raw.path}: gap before {at(raw, rows[gaps[0] + 1])}, segment split there")
        edges = [0, *(gaps + 1).tolist(), time_s.size]
        return list(pairwise(edges))

    def _is_uneven(self, raw: RawSegment, rows: Rows, time_s: Numbers) -> bool:
        intervals = time_s.size - 1
        own_rate = intervals / float(time_s[-1] - time_s[0])
        # In place: for ten million rows each further array takes 80 MB.
        off = np.arange(time_s.size, dtype=np.float64)
        off /= own_rate
        off += time_s[0]
        off -= time_s
        np.abs(off, out=off)
        worst = int(np.argmax(off))
        largest = float(off[worst]) * self.rate_hz
        drift = abs(own_rate / self.rate_hz - 1.0)
        # Crystals differ by less than a ten-thousandth.
        jitters = largest > raw.mapping.jitter_tolerance_samples
        drifts = drift > max(1e-4, raw.mapping.jitter_tolerance_samples / intervals)
        if not (jitters or drifts):
            return False
        what = (
            f"time stamps are uneven: {at(raw, rows[worst])} is {largest / self.rate_hz:.3g} s "
            f"({largest:.2g} samples) from an even spacing, the largest deviation"
            if jitters
            else f"sampled at {own_rate:.7g} Hz from {at(raw, rows[0])} on, the recording is at {self.rate_hz:.7g} Hz"
        )
        if not raw.mapping.resample:
            raise InputError(
                str(raw.path),
                _time_column(raw),
                f"{what}; resample: true interpolates, or sampling_frequency_hz without time where only the stamps "
                "are coarse",
            )
        self._findings.note("resampled", f"{raw.path}: {what}; resampled to {self.rate_hz:g} Hz")
        return True

    def _too_short(self, raw: RawSegment, samples: int) -> None:
        self._findings.dropped_rows[f"fewer than {MIN_STRETCH_SAMPLES} in a row"] += samples
        self._findings.note(
            "short", f"{raw.path}: {samples} samples after {at(raw, 0)} are too few for a segment, left out"
        )


def _time_column(raw: RawSegment) -> str:
    return "time" if raw.mapping.time is None else raw.mapping.time.column


def at(raw: RawSegment, row: int | np.integer[Any]) -> str:
    """The place of a row for a message; rows count from 1 below the names."""
    time_s = float(raw.time_s[row])
    stamp = f" (t = {time_s:.6g} s)" if np.isfinite(time_s) else ""
    return f"row {raw.first_row + int(row) + 1}{stamp}"


def resampled(time_s: Numbers, values: Numbers, rate_hz: float) -> Numbers:
    """Values of shape (n,) or (n, k) at an even spacing from the first time stamp on, interpolated linearly."""
    grid = _grid(time_s, rate_hz)
    if values.ndim == 1:
        return np.asarray(np.interp(grid, time_s, values))
    return np.column_stack([np.interp(grid, time_s, column) for column in values.T])


def resampled_held(time_s: Numbers, values: Numbers, rate_hz: float) -> Numbers:
    """Values of shape (n, k) that are held until the next time stamp, as means over the steps of an even spacing."""
    grid = _grid(time_s, rate_hz)
    return held_means(time_s, values, np.append(grid, grid[-1] + 1.0 / rate_hz))


def held_means(time_s: Numbers, values: Numbers, edges_s: Numbers) -> Numbers:
    """Means of values (n, k), each held until the next time stamp, between neighbours of the m edges: (m - 1, k)."""
    stamps = np.append(time_s, max(edges_s[-1], time_s[-1]) + 1.0)
    integral = np.vstack([np.zeros(values.shape[1]), np.cumsum(values * np.diff(stamps)[:, None], axis=0)])
    reached = np.column_stack([np.interp(edges_s, stamps, column) for column in integral.T])
    means: Numbers = np.diff(reached, axis=0) / np.diff(edges_s)[:, None]
    return means


def _grid(time_s: Numbers, rate_hz: float) -> Numbers:
    # The tolerance includes the last stamp where only rounding misses it.
    samples = int((time_s[-1] - time_s[0]) * rate_hz + 1e-6) + 1
    grid: Numbers = time_s[0] + np.arange(samples) / rate_hz
    return grid


def _roundest(value: float, tolerance: float) -> float:
    """The number with the fewest digits within a relative tolerance of `value`."""
    for digits in range(1, 15):
        rounded = float(f"{value:.{digits}g}")
        if abs(rounded - value) <= tolerance * value:
            return rounded
    return value
