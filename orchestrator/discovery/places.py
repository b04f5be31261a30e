"""Where a law may enter the equations: which signal it changes, and how.

Each place turns a law's values y into a `Correction`. A written effect holds the same expressions, `code`. A law of
two quantities is a curve over one at a place that multiplies it by the other: of a tensor of both, the part of rank
one that is linear in the second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.discovery.quantities import HEAT, TIME, Quantity
from orchestrator.numerics.frames import from_phases, from_two_phases, to_phases
from orchestrator.numerics.types import Array
from protocols import Correction, EffectLayer, SignalBatch


@dataclass(frozen=True)
class Place:
    """A place of a law.

    Attributes
    ----------
    name, text : str
        `text` as in "<a voltage of each leg> over its own current".
    unit : str
        Of the law's values.
    layer : EffectLayer
    of_phases : bool
        Whether y has shape (n, 3), else (n,).
    over_interval : bool
        Whether y is a mean over the interval after each sample, else the value at it.
    typical : float
        A small size of y, in units of `unit_size`.
    apply : callable
        The correction for values y of a batch's samples.
    code : str
        The same as an expression of `signals` and `y`; ``{sensors}`` stands for the Clarke transform of the readings.
    factor : Quantity or None
        What the law's values are multiplied by.
    """

    name: str
    text: str
    unit: str
    layer: EffectLayer
    of_phases: bool
    over_interval: bool
    typical: float
    apply: Callable[[SignalBatch, Array], Correction]
    code: str
    factor: Quantity | None = None


def of_three_sensors(batch: SignalBatch) -> bool:
    """Whether the current's vector was made of three readings."""
    return batch.segments[0].clarke_of_three is True


def _of_readings(batch: SignalBatch, y: Array) -> Array:
    return from_phases(y) if of_three_sensors(batch) else from_two_phases(y[:, 0], y[:, 1])


def _pulse_rate(batch: SignalBatch) -> Array:
    """PWM frequency over the drive's usual one, shape (n, 1) or (1, 1)."""
    usual = batch.drive.pwm_frequency_hz if batch.drive is not None else None
    return np.asarray(
        batch.per_sample(batch.pwm_frequency_hz / (usual or batch.pwm_frequency_hz))[:, None], dtype=np.float64
    )


def _along_d(batch: SignalBatch, y: Array) -> Array:
    return np.stack([y * np.cos(batch.theta_rad), y * np.sin(batch.theta_rad)], axis=1)


LEG_VOLTAGE = Place(
    "leg_voltage", "a voltage that each leg loses", "V", EffectLayer.INVERTER, True, True, 0.01,
    lambda s, y: Correction(v_ab=s.v_ab - from_phases(y)),
    "Correction(v_ab=signals.v_ab - from_phases(y))",
)  # fmt: skip
PULSE_VOLTAGE = Place(
    "pulse_voltage", "a voltage that each leg loses with every pulse", "V", EffectLayer.INVERTER, True, True, 0.01,
    lambda s, y: Correction(v_ab=s.v_ab - from_phases(y) * _pulse_rate(s)),
    "Correction(v_ab=signals.v_ab - from_phases(y) * _pulse_rate(signals))",
)  # fmt: skip
VOLTAGE_GAIN = Place(
    "voltage_gain", "a part of the voltage that is lost", "1", EffectLayer.BUS, False, False, 0.003,
    lambda s, y: Correction(v_ab=s.v_ab * (1.0 - y[:, None])),
    "Correction(v_ab=signals.v_ab * (1.0 - y[:, None]))",
)  # fmt: skip
READING = Place(
    "reading", "an error of each current reading", "A", EffectLayer.CURRENT_SENSORS, True, False, 0.003,
    lambda s, y: Correction(i_ab=s.i_ab - _of_readings(s, y)),
    "Correction(i_ab=signals.i_ab - {sensors})",
)  # fmt: skip
READING_GAIN = Place(
    "reading_gain", "an error of each current sensor's gain", "1", EffectLayer.CURRENT_SENSORS, True, False, 0.003,
    lambda s, y: Correction(i_ab=s.i_ab - _of_readings(s, y / (1.0 + y) * to_phases(s.i_ab))),
    "Correction(i_ab=signals.i_ab - {sensors})",
)  # fmt: skip
RESISTANCE = Place(
    "resistance", "a resistance beside R_s", "ohm", EffectLayer.RESISTANCE, False, False, 0.01,
    lambda s, y: Correction(resistance_ohm=s.resistance_ohm + y),
    "Correction(resistance_ohm=signals.resistance_ohm + y)",
)  # fmt: skip
LEG_RESISTANCE = Place(
    "leg_resistance", "a resistance of one phase", "ohm", EffectLayer.RESISTANCE, True, False, 0.01,
    lambda s, y: Correction(v_ab=s.v_ab - from_phases(y * to_phases(s.i_ab))),
    "Correction(v_ab=signals.v_ab - from_phases(y * to_phases(signals.i_ab)))",
)  # fmt: skip
ANGLE = Place(
    "angle", "a rotation of the rotor", "rad", EffectLayer.FRAME, False, False, 0.001,
    lambda s, y: Correction(theta_rad=s.theta_rad + y),
    "Correction(theta_rad=signals.theta_rad + y)",
)  # fmt: skip
MAGNETISING = Place(
    "magnetising", "a current along each phase that does not magnetise", "A", EffectLayer.IRON, True, False, 0.003,
    lambda s, y: Correction(i_m_ab=s.i_m_ab - from_phases(y)),
    "Correction(i_m_ab=signals.i_m_ab - from_phases(y))",
)  # fmt: skip
MAGNETISING_D = Place(
    "magnetising_d", "a shift of the map along i_d", "A", EffectLayer.IRON, False, False, 0.003,
    lambda s, y: Correction(i_m_ab=s.i_m_ab - _along_d(s, y)),
    "Correction(i_m_ab=signals.i_m_ab - np.stack([y * np.cos(signals.theta_rad), y * np.sin(signals.theta_rad)], 1))",
)  # fmt: skip


def _growing(place: Place, by: Quantity) -> Place:
    """A place of the phases whose law is multiplied by a quantity."""

    def apply(batch: SignalBatch, y: Array) -> Correction:
        return place.apply(batch, y * by.of(batch)[:, None])

    name, text, unit = f"{place.name}_by_{by.name}", f"{place.text} in proportion to {by.text}", by.unit
    return replace(place, name=name, text=text, unit=f"{place.unit}/{unit}", apply=apply, factor=by)


LEG_VOLTAGE_BY_TIME, PULSE_VOLTAGE_BY_TIME, LEG_VOLTAGE_BY_HEAT, READING_BY_TIME = (
    _growing(place, by)
    for place, by in ((LEG_VOLTAGE, TIME), (PULSE_VOLTAGE, TIME), (LEG_VOLTAGE, HEAT), (READING, TIME))
)
