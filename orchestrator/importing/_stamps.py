"""Convert time stamps to seconds: units, counters that wrap, dates, and epochs relative to the import's first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._source import Block, Numbers
from orchestrator.importing._units import FACTORS
from protocols import InputError

EPOCH_S = 1e8
"""Stamps beyond this [s] count from an epoch: no experiment lasts three years."""


class Stamps:
    """The clock of one import; holds the state between blocks and files."""

    def __init__(self) -> None:
        self._origin_s: float | None = None
        self._last, self._turns = 0.0, 0

    @property
    def since_epoch(self) -> bool:
        """Whether the stamps were dates, or as large as seconds since an epoch."""
        return bool(self._origin_s)

    def next_file(self) -> None:
        """Begin another file: the count of wraps restarts."""
        self._last, self._turns = 0.0, 0

    def seconds(self, mapping: ImportMapping, block: Block, row: int) -> Numbers:
        """The stamps [s] of a block whose first row is `row` of its file; dates count from the import's first."""
        time = mapping.time
        if time is None:
            assert mapping.sampling_frequency_hz is not None  # the mapping has either
            rows: Numbers = np.arange(row, row + len(block)) / mapping.sampling_frequency_hz
            return rows
        raw = block.numbers[time.column]
        if time.wraps_at is not None:
            raw = self._unwrapped(raw, time.wraps_at)
        unit_s = 1.0 / time.tick_hz if time.tick_hz is not None else FACTORS[time.unit]
        if self._origin_s is None:
            known = raw[np.isfinite(raw)]
            first_s = float(known[0]) * unit_s if known.size else 0.0
            if known.size:
                self._origin_s = first_s if time.unit == "iso" or abs(first_s) > EPOCH_S else 0.0
        # In ticks the difference of neighbours is exact.
        return (raw - (self._origin_s or 0.0) / unit_s) * unit_s if self._origin_s else raw * unit_s

    def _unwrapped(self, raw: Numbers, wraps_at: float) -> Numbers:
        finite = np.isfinite(raw)
        known = raw[finite]
        # A step back is a wrap of the counter; a pause may hide further wraps.
        back = np.diff(known, prepend=self._last) < 0.0
        turns = self._turns + np.cumsum(back)
        out = np.full_like(raw, np.nan)
        out[finite] = known + turns * wraps_at
        if known.size:
            self._last, self._turns = float(known[-1]), int(turns[-1])
        return out


def dates_as_seconds(path: Path, name: str, texts: Any) -> Numbers:
    """Dates, or times of a day, in ISO 8601 as seconds since 1970 (since midnight); NaN where there is none.

    Parameters
    ----------
    texts : pyarrow array or sequence
        Texts such as ``2026-11-23T06:45:35.123Z`` or ``06:45:35,123``; or time stamps already.

    Raises
    ------
    InputError
        Where a text is no date.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    column = texts if isinstance(texts, pa.Array | pa.ChunkedArray) else pa.array(texts)
    try:
        if pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            column = pc.replace_substring(pc.utf8_trim_whitespace(column), ",", ".")
            column = pc.if_else(pc.equal(column, ""), None, column)
            column = column.cast(_kind(next((str(x) for x in column if x.is_valid), "")))
        if pa.types.is_timestamp(column.type):
            column = column.cast(pa.timestamp("ns", column.type.tz))
        numbers = column.cast(pa.int64()).to_numpy(zero_copy_only=False) * 1e-9
    except (pa.ArrowException, OverflowError) as error:
        reason = " ".join(str(error).split())[:80]
        raise InputError(str(path), name, f"expected dates as 2026-11-23T06:45:35.123 ({reason})") from None
    return np.asarray(numbers, dtype=np.float64)


def _kind(first: str) -> Any:
    import pyarrow as pa

    if "-" not in first[:10]:
        return pa.time64("ns")
    has_zone = first.endswith(("Z", "z")) or "+" in first[10:] or "-" in first[11:]
    return pa.timestamp("ns", "UTC" if has_zone else None)
