"""Prior of the stator resistance from the nameplate, and the winding's temperature rise from its drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from protocols import Interval, Motor, ResistanceReading

DEFAULT_RESISTANCE_STD_RATIO = 0.1
"""Assumed std of a nameplate's R_s over its value: copper 25 K off the data sheet's temperature."""
COPPER_PER_K = 0.00393
"""Temperature coefficient of resistance of annealed copper at 20 C [1/K] (IEC 60028, International Annealed Copper
Standard)."""


@dataclass(frozen=True)
class KnownResistance:
    """A normal prior of R_s [ohm].

    Attributes
    ----------
    value_ohm, std_ohm : float
    is_measured : bool
        Whether its standard deviation was stated; a nameplate without one is no measurement.
    """

    value_ohm: float
    std_ohm: float
    is_measured: bool

    def with_measured(self, value_ohm: float, std_ohm: float) -> tuple[float, float]:
        """Mean and standard deviation of the prior and a measurement, weighted by their inverse variances."""
        information = self.std_ohm**-2 + std_ohm**-2
        mean = (self.value_ohm / self.std_ohm**2 + value_ohm / std_ohm**2) / information
        return mean, information**-0.5

    def apart(self, value_ohm: float, std_ohm: float) -> float:
        """Distance of a measurement from the prior, in standard deviations of their difference."""
        return float(abs(value_ohm - self.value_ohm) / (self.std_ohm**2 + std_ohm**2) ** 0.5)


def known_resistance(motor: Motor) -> KnownResistance | None:
    """The nameplate's resistance; None where it states none."""
    if motor.stator_resistance_ohm is None:
        return None
    stated_std = motor.stator_resistance_std_ohm
    std = DEFAULT_RESISTANCE_STD_RATIO * motor.stator_resistance_ohm if stated_std is None else stated_std
    return KnownResistance(motor.stator_resistance_ohm, std, stated_std is not None)


def temperature_rise(readings: Sequence[ResistanceReading]) -> Interval | None:
    """Rise of the winding's temperature from the first reading to the last [K], with its 95 % interval.

    dT = (R_last / R_first - 1) / alpha, for a winding of copper that started at 20 C; at another temperature T it is
    1 + alpha (T - 20 C) times that. Errors common to both readings count as independent, so the interval is rather too
    wide than too narrow.

    Parameters
    ----------
    readings : sequence of ResistanceReading
        In order of time.

    Returns
    -------
    Interval or None
        None with fewer than two readings, and where the first or last is not positive.
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
