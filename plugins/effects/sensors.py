"""Errors of two current sensors, in phases a and b, whose third phase is computed: gain, offset, curvature."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from orchestrator.numerics.frames import from_two_phases, to_phases
from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude


class CurrentGainMismatch:
    """Gains 1 + g/2 of sensor a and 1 - g/2 of sensor b, g dimensionless; i_c = -i_a - i_b as computed."""

    name: ClassVar[str] = "current_gain_mismatch"
    summary: ClassVar[str] = "The current sensors of phases a and b differ in gain."
    signature: ClassVar[str] = "Anisotropic resistance and inductance, second harmonic of the current's angle."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A gain common to both sensors scales R_s and the flux together."

    class Parameters(EffectParameters):
        gain_a_minus_b: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Divide each sensor's reading by its gain."""
        half = 0.5 * p.gain_a_minus_b
        a, b = to_phases(np.eye(2))[:, :2].T
        return Correction(i_ab=signals.i_ab @ from_two_phases(a / (1.0 + half), b / (1.0 - half)))


class CurrentOffset:
    """Sensors a and b read i + o [A]; the computed phase c reads i_c - o_a - o_b."""

    name: ClassVar[str] = "current_offset"
    summary: ClassVar[str] = "The current sensors read a constant beside the current."
    signature: ClassVar[str] = (
        "A constant residual R_s o under direct current, also with the gates off, and a shifted map."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF,)
    gauge: ClassVar[str] = "Without a gates-off reading an offset o equals a voltage bias R_s o."

    class Parameters(EffectParameters):
        offset_a_a: float = amplitude("A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5)
        offset_b_a: float = amplitude("A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Subtract the offsets."""
        return Correction(i_ab=signals.i_ab - from_two_phases(p.offset_a_a, p.offset_b_a))


class CurrentNonlinearity:
    """Sensors a and b read i + k i^3 [A], k in 1/A^2: a core that begins to saturate, or the amplifier behind it."""

    name: ClassVar[str] = "current_nonlinearity"
    summary: ClassVar[str] = "The current sensors' characteristic is curved."
    signature: ClassVar[str] = "Resistance and map bend alike as the phase current grows."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        cubic_per_a2: float = amplitude("1/A^2", typical=3e-4, prior_width=1e-3, low=-0.02, high=0.02)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Solve m = i + k i^3 for i in each sensor, by two fixed-point steps from the reading."""
        k = p.cubic_per_a2
        read = to_phases(signals.i_ab)[:, :2]
        square = read * read
        near = read * (1.0 - k * square / (1.0 + 3.0 * abs(k) * square))
        return Correction(i_ab=from_two_phases(*(read - k * near * near * near).T))
