"""What a recording logs beside vectors and bus, as effects see it: three phase currents, a temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orchestrator.numerics.frames import from_phases, from_two_phases
from protocols import Capture, RealArray, Signals

_ROWS_COMPARED = 2000
"""Rows by which it is seen of what a vector was made."""
_LOG_ROUNDING = 1e-3
"""Of the current: by how much a vector may be off what it was made of, by the rounding of a log."""
_SINGLE_PRECISION_ROUNDING = 1e-6
"""The same by the rounding of single precision."""


def logged_fields(capture: Capture, rows: int, width: int) -> dict[str, Any]:
    """The fields of `Signals` that only some recordings have.

    Parameters
    ----------
    rows : int
        Of the signals.
    width : int
        Readings of which each row is the mean.
    """
    found: dict[str, Any] = {}
    if capture.i_abc is not None:
        found["i_abc"] = _means(capture.i_abc, rows, width)
        found["clarke_of_three"] = clarke_of_three(capture.i_ab, capture.i_abc)
    if capture.temperature_c is not None:
        found["temperature_c"] = _means(capture.temperature_c, rows, width)
    return found


def clarke_of_three(i_ab: RealArray, i_abc: RealArray) -> bool | None:
    """Whether vectors (n, 2) were made of three readings (n, 3), or of a and b alone; None: of something else.

    Where the third was computed from the first two, it is the same, and no third reading.
    """
    rows = slice(None, None, max(1, len(i_ab) // _ROWS_COMPARED))
    vector, phases = i_ab[rows], i_abc[rows]
    off_three = float(np.abs(vector - from_phases(phases)).max())
    off_two = float(np.abs(vector - from_two_phases(phases[:, 0], phases[:, 1])).max())
    size = float(np.abs(vector).max())
    if _SINGLE_PRECISION_ROUNDING * size < off_two and off_three < 0.1 * off_two:
        return True
    return False if off_two <= _LOG_ROUNDING * size else None


def since_the_start(signals: Sequence[Signals]) -> list[Signals]:
    """Signals in the order of time, each with the first temperature that was logged."""
    first = next((float(s.temperature_c[0]) for s in signals if s.temperature_c is not None), None)
    return list(signals) if first is None else [replace(s, start_temperature_c=first) for s in signals]


def _means(readings: RealArray, rows: int, width: int) -> RealArray:
    """Means of `width` readings each, as many as `rows`; the readings themselves where it is one."""
    used = readings[: rows * width]
    return used if width == 1 else used.reshape(rows, width, -1).mean(axis=1).reshape((rows, *readings.shape[1:]))
