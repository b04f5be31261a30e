"""Scaling of effects' parameters from the 400 W reference machine to the machine under test."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from protocols import EffectParameter, Manifest, ParameterRole, unit_powers


@dataclass(frozen=True)
class MachineScale:
    """Ratios of a machine's ratings to those of the reference machine; 1 where the nameplate has none.

    Attributes
    ----------
    amps, volts, ohms, webers : float
        Ratios of the rated current, the bus voltage, the phase resistance, and L_d times the rated current.
    """

    amps: float
    volts: float
    ohms: float
    webers: float

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        *,
        rated_current_rms_a: float = 1.66,
        dc_bus_voltage_v: float = 540.0,
        stator_resistance_ohm: float = 4.25,
        d_inductance_h: float = 0.04325,
    ) -> MachineScale:
        """From a recording's nameplate and the reference machine's ratings, which are the defaults."""
        motor = manifest.motor
        amps = (motor.rated_current_rms_a or rated_current_rms_a) / rated_current_rms_a
        volts = manifest.drive.dc_bus_voltage_v / dc_bus_voltage_v
        ohms = motor.stator_resistance_ohm / stator_resistance_ohm if motor.stator_resistance_ohm else volts / amps
        webers = (motor.d_inductance_h / d_inductance_h if motor.d_inductance_h else ohms) * amps
        return cls(amps, volts, ohms, webers)

    def of_unit(self, unit: str) -> float:
        """Ratio for a quantity of this unit; 1 for units that do not scale."""
        scales = {
            "A": self.amps,
            "V": self.volts,
            "ohm": self.ohms,
            "Wb": self.webers,
            "H": self.webers / self.amps,
            "W": self.ohms * self.amps**2,
            "Nm": self.webers * self.amps,
        }
        return math.prod(scales.get(symbol, 1.0) ** power for symbol, power in unit_powers(unit).items())

    def scaled(self, p: EffectParameter) -> EffectParameter:
        """The parameter scaled to this machine; a shape's prior width, in its logit, does not change."""
        factor = self.of_unit(p.unit)
        names = ["typical", "low", "high", "neutral"]
        if p.role is not ParameterRole.SHAPE:
            names.append("prior_width")
        if p.other_form is not None:
            names.append("other_form")
        return dataclasses.replace(p, **{name: getattr(p, name) * factor for name in names})
