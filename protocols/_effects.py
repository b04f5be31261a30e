"""Effects: physical imperfections that a model may lack, as the diagnosis tries them one by one.

An effect turns what the drive believes into what the motor felt: sensor readings into stator
current, commanded voltage into impressed voltage, believed angle into the true one. It is a pure
function of a recording's signals; entry point group ``fluxbench.effects``.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import ClassVar, Protocol, runtime_checkable

from protocols._base import ArrayModel, Samples, Strict, Vectors


class EffectLayer(IntEnum):
    """Where an effect acts; effects are applied in this order, from the sensors inwards."""

    CURRENT_SENSORS = 1
    DELAY = 2
    BUS = 3
    INVERTER = 4
    RESISTANCE = 5
    FRAME = 6
    IRON = 7


class EffectParameter(Strict):
    """One parameter of an effect, in SI."""

    name: str
    unit: str
    typical: float
    """The size met in practice; relative sizes refer to it."""
    prior_width: float
    """Standard deviation of the prior about zero effect."""
    low: float
    high: float
    neutral: float
    """The value at which the effect is absent (may be infinite in principle; then the bound)."""
    strong_when_small: bool = False
    """Relative size is typical / value instead of value / typical."""


class Signals(ArrayModel):
    """One segment as an effect sees it, each quantity at its current best; time first.

    Starts as what was measured and commanded; each effect returns a corrected one.
    """

    start_s: float
    sampling_frequency_hz: float
    pwm_frequency_hz: float
    i_ab: Vectors
    """Stator current [A]."""
    v_ab: Vectors
    """Voltage at the terminals [V]."""
    v_dc: Samples
    theta_rad: Samples
    """Electrical angle of the d axis."""
    resistance_ohm: Samples
    i_m_ab: Vectors
    """The part of the stator current that magnetises [A]."""
    heat_j: Samples
    """Copper loss since the start of the experiment."""


@runtime_checkable
class Effect(Protocol):
    """A candidate for what the model lacks."""

    name: ClassVar[str]
    summary: ClassVar[str]
    """One sentence: what it is."""
    signature: ClassVar[str]
    """One sentence: what it does to the residual."""
    layer: ClassVar[EffectLayer]
    family: ClassVar[str]
    """Effects of one family are shapes of the same physics, from simple to flexible."""
    twins: ClassVar[tuple[str, ...]]
    """Effects that it cannot be told from without the experiments below."""
    experiments: ClassVar[tuple[str, ...]]
    """What to measure to tell it from its twins."""
    gauge: ClassVar[str]
    """What no measurement of this kind can show; empty where nothing."""
    parameters: ClassVar[tuple[EffectParameter, ...]]

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """The signals with this effect accounted for; at the neutral values they come back equal."""
        ...
