"""Optional channels of a recording for effects: three phase currents, a temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orchestrator.numerics.frames import from_phases, from_two_phases
from protocols import Capture, RealArray, Signals

_ROWS_COMPARED = 2000
"""Rows compared to find the readings from which a vector was computed."""
_LOG_ROUNDING = 1e-3
"""Relative deviation of a vector from its readings that the rounding of a log explains."""
_SINGLE_PRECISION_ROUNDING = 1e-6
"""Relative deviation that single precision explains."""


def logged_fields(capture: Capture, rows: int, width: int) -> dict[str, Any]:
    """The optional fields of `Signals`.

    Parameters
    ----------
    rows : int
        Number of rows of the signals.
    width : int
        Readings averaged in each row.
    """
    found: dict[str, Any] = {}
    if capture.i_abc is not None:
        found["i_abc"] = _means(capture.i_abc, rows, width)
        found["clarke_of_three"] = clarke_of_three(capture.i_ab, capture.i_abc)
    if capture.temperature_c is not None:
        found["temperature_c"] = _means(capture.temperature_c, rows, width)
    return found


def clarke_of_three(i_ab: RealArray, i_abc: RealArray) -> bool | None:
    """Whether vectors (n, 2) were computed from three readings (n, 3), or from a and b alone; None: from neither.

    A third current that was computed from the other two is no reading: the result is False.
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
    """Signals in temporal order, each with the first logged temperature."""
    first = next((float(s.temperature_c[0]) for s in signals if s.temperature_c is not None), None)
    return list(signals) if first is None else [replace(s, start_temperature_c=first) for s in signals]


def _means(readings: RealArray, rows: int, width: int) -> RealArray:
    """Means of `width` readings each, `rows` in all."""
    used = readings[: rows * width]
    return used if width == 1 else used.reshape(rows, width, -1).mean(axis=1).reshape((rows, *readings.shape[1:]))
