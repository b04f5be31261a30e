"""The PWM frequency of a segment, by its column or by the edges of the switching states: holds at two of them separate
a dead time from a forward drop. Commanded voltages alone do not show it."""

from __future__ import annotations

from typing import Any

import numpy as np

from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._source import Numbers
from orchestrator.importing._splitting import RawSegment
from orchestrator.importing._units import FACTORS
from orchestrator.importing._vectors import LEGS
from protocols import InputError

SAME_FREQUENCY: float = 0.05
"""Relative difference of two PWM frequencies that count as one."""
MIN_PERIODS: int = 20
"""Periods of a leg from whose edges a frequency is read."""
MIN_ROWS_PER_PERIOD: float = 8.0
"""Rows of a period below which edges are lost between them."""
MAX_SPREAD: float = 0.25
"""Range of the middle four fifths of a leg's periods, over their median, up to which they are those of a carrier."""


def settings_of(raw: RawSegment, rate_hz: float) -> dict[str, Any]:
    """The rule's settings, with `pwm_frequency_hz` where the rows show another one than the drive's.

    Raises
    ------
    InputError
        Where the rows show another one than the rule states.
    """
    settings = dict(raw.mapping.segments[raw.rule].settings)
    shown_hz = _shown_hz(raw, rate_hz)
    if shown_hz is None:
        return settings
    stated_hz = settings.get("pwm_frequency_hz")
    if stated_hz is not None and not _same(shown_hz, float(stated_hz)):
        problem = f"the rows show a PWM frequency of {shown_hz:.6g} Hz, this states {float(stated_hz):.6g} Hz"
        raise InputError(str(raw.path), f"segments.{raw.rule}.settings.pwm_frequency_hz", problem)
    drive_hz = raw.mapping.drive.pwm_frequency_hz
    if stated_hz is None and (drive_hz is None or not _same(shown_hz, drive_hz)):
        settings["pwm_frequency_hz"] = shown_hz
    return settings


def _same(a_hz: float, b_hz: float) -> bool:
    return abs(a_hz / b_hz - 1.0) <= SAME_FREQUENCY


def _shown_hz(raw: RawSegment, rate_hz: float) -> float | None:
    """By the column where there is one, else by the states; None where neither shows it."""
    mapping = raw.mapping
    if mapping.pwm_frequency is None:
        return _by_edges_hz(mapping, raw, rate_hz)
    column = mapping.pwm_frequency
    numbers = raw.columns[column.column]
    number = float(np.nanmedian(numbers)) if np.isfinite(numbers).any() else np.nan
    hz = (number - column.offset) * column.factor * FACTORS[column.unit]
    if not hz > 0.0:
        raise InputError(str(raw.path), column.column, f"expected a PWM frequency, got {number:g} {column.unit}")
    return hz


def _by_edges_hz(mapping: ImportMapping, raw: RawSegment, rate_hz: float) -> float | None:
    """The frequency at which the busiest leg is switched on, to three digits."""
    numbering = mapping.voltage.numbering
    if numbering is None:
        return None
    states = raw.columns[mapping.voltage.columns["state"]]
    legs: Numbers = LEGS[numbering][np.nan_to_num(states).astype(np.intp)]
    edges = [np.flatnonzero(np.diff(leg) > 0.0) for leg in legs.T]
    rows = np.diff(max(edges, key=len))
    if len(rows) < MIN_PERIODS:
        return None
    low, period, high = np.quantile(rows, (0.1, 0.5, 0.9))
    if period < MIN_ROWS_PER_PERIOD or high - low > MAX_SPREAD * period:
        return None
    within = rows[(rows >= low) & (rows <= high)]
    return float(f"{rate_hz / float(within.mean()):.3g}")
