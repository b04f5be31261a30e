"""What a drift of R_s says of the winding's temperature: copper is assumed, and nothing is fitted."""

from __future__ import annotations

from collections.abc import Sequence

from protocols import Interval, ResistanceReading

COPPER_PER_K = 0.00393
"""Temperature coefficient of resistance of annealed copper at 20 C [1/K] (IEC 60028, International Annealed Copper
Standard)."""


def temperature_rise(readings: Sequence[ResistanceReading]) -> Interval | None:
    """Rise of the winding's temperature from the first reading to the last [K], with its 95 % interval.

    dT = (R_last / R_first - 1) / alpha, for a winding of copper that started at 20 C; at another temperature T it is
    1 + alpha (T - 20 C) times that. What both readings err alike is counted as if they erred apart, so the interval is
    rather too wide than too narrow.

    Parameters
    ----------
    readings : sequence of ResistanceReading
        In order of time.

    Returns
    -------
    Interval or None
        None with fewer than two readings, for nothing drifted that was seen once, and where the first or last is no
        resistance.
    """
    if len(readings) < 2:
        return None
    first, last = readings[0], readings[-1]
    if first.value_ohm <= 0.0 or last.value_ohm <= 0.0:
        return None
    ratio = last.value_ohm / first.value_ohm
    std = abs(ratio) * ((first.std_ohm / first.value_ohm) ** 2 + (last.std_ohm / last.value_ohm) ** 2) ** 0.5
    rise, half = (ratio - 1.0) / COPPER_PER_K, 1.96 * std / COPPER_PER_K
    return Interval(value=rise, low=rise - half, high=rise + half, unit="K")
