"""Errors of two current sensors, in phases a and b, whose third phase is computed: gain, offset, curvature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from orchestrator.numerics.frames import from_two_phases, to_phases
from orchestrator.numerics.types import Array
from protocols import EffectLayer, EffectParameter, Signals


def _shifted(signals: Signals, change: Array) -> Signals:
    return signals.model_copy(update={"i_ab": signals.i_ab + change, "i_m_ab": signals.i_m_ab + change})


class CurrentGainMismatch:
    """Gains 1 + g/2 of sensor a and 1 - g/2 of sensor b, g dimensionless; i_c = -i_a - i_b as computed."""

    name: ClassVar[str] = "current_gain_mismatch"
    summary: ClassVar[str] = "The current sensors of phases a and b differ in gain."
    signature: ClassVar[str] = "Anisotropic resistance and inductance, second harmonic of the current's angle."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    family: ClassVar[str] = "sensor_gain"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("signal injection: the inductance is anisotropic as well",)
    gauge: ClassVar[str] = "A gain common to both sensors scales R_s and the flux together."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="gain_a_minus_b", unit="1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2, neutral=0.0
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Divide each sensor's reading by its gain."""
        half = 0.5 * values["gain_a_minus_b"]
        if half == 0.0:
            return signals
        phases = to_phases(signals.i_ab)
        a, b = phases[:, 0], phases[:, 1]
        return _shifted(signals, from_two_phases(a * (1.0 / (1.0 + half) - 1.0), b * (1.0 / (1.0 - half) - 1.0)))


class CurrentOffset:
    """Sensors a and b read i + o [A]; the computed phase c reads i_c - o_a - o_b."""

    name: ClassVar[str] = "current_offset"
    summary: ClassVar[str] = "The current sensors read a constant beside the current."
    signature: ClassVar[str] = (
        "A constant residual R_s o under direct current, also with the gates off, and a shifted map."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    family: ClassVar[str] = "constant"
    twins: ClassVar[tuple[str, ...]] = ("voltage_bias",)
    experiments: ClassVar[tuple[str, ...]] = ("read the sensors with all gates off",)
    gauge: ClassVar[str] = "Without a gates-off reading an offset o equals a voltage bias R_s o."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="offset_a_a", unit="A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5, neutral=0.0),
        EffectParameter(name="offset_b_a", unit="A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5, neutral=0.0),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Subtract the offsets."""
        offset = from_two_phases(values["offset_a_a"], values["offset_b_a"])
        return _shifted(signals, -offset) if offset.any() else signals


class CurrentNonlinearity:
    """Sensors a and b read i + k i^3 [A], k in 1/A^2: a core that begins to saturate, or the amplifier behind it."""

    name: ClassVar[str] = "current_nonlinearity"
    summary: ClassVar[str] = "The current sensors' characteristic is curved."
    signature: ClassVar[str] = "Resistance and map bend alike as the phase current grows."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    family: ClassVar[str] = "sensor_curvature"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("compare with an external ammeter at three currents",)
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="cubic_per_a2", unit="1/A^2", typical=3e-4, prior_width=1e-3, low=-0.02, high=0.02, neutral=0.0
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Solve m = i + k i^3 for i in each sensor, by two fixed-point steps from the reading."""
        k = values["cubic_per_a2"]
        if k == 0.0:
            return signals
        read = to_phases(signals.i_ab)[:, :2]
        square = read * read
        true = read * (1.0 - k * square / (1.0 + 3.0 * abs(k) * square))
        true = read - k * true * true * true
        return _shifted(signals, from_two_phases(*(true - read).T))
