"""Prior of the stator resistance from the nameplate, with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

from protocols import Motor

UNSTATED = 0.1
"""Relative standard deviation of a nameplate without one: copper 25 K from the data sheet's temperature."""


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
    stated = motor.stator_resistance_std_ohm
    std = UNSTATED * motor.stator_resistance_ohm if stated is None else stated
    return KnownResistance(motor.stator_resistance_ohm, std, stated is not None)
