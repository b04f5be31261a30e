"""Effects: physical imperfections that a model may lack, as the diagnosis tries them one by one.

An effect turns what the drive believes into what the motor felt: sensor readings into stator
current, commanded voltage into impressed voltage, believed angle into the true one. It is a pure
function of a recording's signals; entry point group ``fluxbench.effects``.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, StrEnum
from typing import Annotated, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from protocols._base import ArrayModel, Samples, Shape, Strict, Vectors
from protocols._motor import Motor
from protocols._recording import DriveRecord


class EffectLayer(IntEnum):
    """Where an effect acts; effects are applied in this order, from the sensors inwards."""

    CURRENT_SENSORS = 1
    DELAY = 2
    BUS = 3
    INVERTER = 4
    RESISTANCE = 5
    FRAME = 6
    IRON = 7


class ParameterRole(StrEnum):
    """What a parameter does in its effect; the diagnosis frees them in this order."""

    AMPLITUDE = "amplitude"
    """Alone decides whether the effect is there: nothing happens while all amplitudes are neutral."""
    SHAPE = "shape"
    """Says how the amplitude acts; has no effect of its own, and is positive (fitted on a log scale)."""
    REFINEMENT = "refinement"
    """Makes the effect's form more flexible; neutral is the simple form."""


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
    role: ParameterRole = ParameterRole.AMPLITUDE


Curve = Annotated[np.ndarray[Any, np.dtype[np.floating[Any]]], Shape(("m",))]


class LossHistory(ArrayModel):
    """Copper loss over the whole experiment, coarsely sampled; what was not captured is estimated."""

    time_s: Curve
    """Since the start of the experiment, increasing, shape (m,)."""
    power_w: Curve
    """Mean loss from this instant to the next, shape (m,)."""
    captured: Curve | None = None
    """1 where it was measured, 0 where it is assumed, shape (m,); None: measured throughout."""


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
    psi_ab: Vectors | None = None
    """Flux linkage at the measured current by the model as it stands, magnet included [Wb]; None without a model."""
    psi_smooth_ab: Vectors | None = None
    """The same without the current's noise: fast changes from the voltage, slow ones from the model [Wb]."""
    i_smooth_ab: Vectors | None = None
    """The stator current that belongs to the smooth flux [A]."""
    losses: LossHistory | None = None
    motor: Motor | None = None
    """The nameplate."""
    drive: DriveRecord | None = None
    bridge_on: bool = True
    """False while all gates are off: then no voltage is commanded and none is impressed."""


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
