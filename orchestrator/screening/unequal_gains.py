"""Gains that differ between two axes of the current or of the voltage, whatever the sensors, as rivals of an effect.

    i_true = S i,   v_true = S v,   S = [[1 + p, q], [q, 1 - p]]

At one rotor angle such an S is nearly unequal resistances, and only S changes the map. The library has the sensors'
errors in the form in which drives have them; what stands in for them here need not have that form.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from orchestrator.numerics.types import Array
from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude


class Stretch(EffectParameters):
    """S: a gain of 1 + p along phase a and of 1 - p across it, and q between both."""

    along_a: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)
    between: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)


def _stretched(vectors: Array, p: Stretch) -> Array:
    return np.asarray(vectors @ np.array([[1.0 + p.along_a, p.between], [p.between, 1.0 - p.along_a]]))


class UnequalCurrentGains:
    """The currents' axes are read with different gains."""

    name: ClassVar[str] = "unequal_current_gains"
    summary: ClassVar[str] = "The currents' axes are read with different gains."
    signature: ClassVar[str] = "Resistance and inductance are stretched alike."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A gain common to both axes scales R_s and the flux together."
    Parameters = Stretch

    def correct(self, signals: Signals, p: Stretch) -> Correction:
        """The currents by S."""
        return Correction(i_ab=_stretched(np.asarray(signals.i_ab, dtype=np.float64), p))


class UnequalVoltageGains:
    """The voltages' axes are applied with different gains."""

    name: ClassVar[str] = "unequal_voltage_gains"
    summary: ClassVar[str] = "The voltages' axes are applied with different gains."
    signature: ClassVar[str] = "Resistance and inductance are stretched alike."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A gain common to both axes scales R_s and the flux together."
    Parameters = Stretch

    def correct(self, signals: Signals, p: Stretch) -> Correction:
        """The voltages by S."""
        return Correction(v_ab=_stretched(np.asarray(signals.v_ab, dtype=np.float64), p))
