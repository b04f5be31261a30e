"""The resistance that is known before anything is measured: the nameplate's, with how far it is believed."""

from __future__ import annotations

from dataclasses import dataclass

from protocols import Motor

UNSTATED = 0.1
"""Relative standard deviation of a nameplate that says none: copper that is 25 K off the data sheet's."""


@dataclass(frozen=True)
class KnownResistance:
    """A normal prior of R_s [ohm].

    Attributes
    ----------
    value_ohm, std_ohm : float
    is_measured : bool
        Whether its standard deviation was stated: a nameplate's alone is no measurement, and weighs nothing beside one.
    """

    value_ohm: float
    std_ohm: float
    is_measured: bool

    def with_measured(self, value_ohm: float, std_ohm: float) -> tuple[float, float]:
        """Mean and standard deviation of this and a measurement of its own, weighted by what each knows."""
        information = self.std_ohm**-2 + std_ohm**-2
        mean = (self.value_ohm / self.std_ohm**2 + value_ohm / std_ohm**2) / information
        return mean, information**-0.5

    def apart(self, value_ohm: float, std_ohm: float) -> float:
        """By how many standard deviations of their difference a measurement is off it."""
        return float(abs(value_ohm - self.value_ohm) / (self.std_ohm**2 + std_ohm**2) ** 0.5)


def known_resistance(motor: Motor) -> KnownResistance | None:
    """What nameplate or data sheet say; None where they say nothing."""
    if motor.stator_resistance_ohm is None:
        return None
    stated = motor.stator_resistance_std_ohm
    std = UNSTATED * motor.stator_resistance_ohm if stated is None else stated
    return KnownResistance(motor.stator_resistance_ohm, std, stated is not None)
