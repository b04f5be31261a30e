"""Options of the switched inverter, and of the sensors of a drive with such an inverter."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols import NonNegative, Positive, Strict


class Bus(Strict):
    """The DC bus behind the bridge."""

    resistance_ohm: NonNegative = 0.0
    """Resistance of the source."""
    capacitance_f: NonNegative = 0.0
    """Capacitance across the bridge; 0: the bus voltage follows its load without a lag."""
    logged: Literal["measured", "nominal"] = "measured"
    """Whether rows and telemetry hold the measured or the nominal bus voltage."""
    gain: Annotated[float, Field(gt=0.5, lt=1.5)] = 1.0
    """Measured over true voltage."""
    compensated: bool = False
    """Whether duties are computed with the measured bus voltage, or with the nominal one."""


class Switching(Strict):
    """An inverter of three legs on a symmetric carrier, edge by edge.

    An edge is delayed by the dead time where a diode holds the node. Where the current commutates the node, it charges
    the capacitances of both devices, dv/dt = i / (2 C), and the loss per period falls towards zero current:
    t_d - C V / i. The current is that at the edge, ripple included.

    Where an option is omitted, the effects `dead_time`, `device_drop`, `bus_sag` and `voltage_delay` of the plant
    supply its value.
    """

    dead_time_s: NonNegative | tuple[NonNegative, NonNegative, NonNegative] | None = None
    """One for all legs, or one each. None: that which loses `effects.dead_time.voltage_v` at the own PWM frequency."""
    output_capacitance_f: NonNegative | None = None
    """Of one device. None: from `effects.dead_time.threshold_a` (4 % of the rated current)."""
    grading: Annotated[float, Field(ge=0.0, le=0.8)] = 0.0
    """Exponent m of the capacitance, proportional to v^-m: 1/2 for an abrupt junction, 0 for a constant capacitance.
    `output_capacitance_f` is then the constant capacitance of equal charge."""
    switch_drop_v: NonNegative | None = None
    """Forward drop at zero current. None: `effects.device_drop.voltage_v`."""
    switch_ohm: NonNegative | None = None
    diode_drop_v: NonNegative | None = None
    """None: equal to the switch's."""
    diode_ohm: NonNegative | None = None
    drop_knee_a: Positive | None = None
    """Current below which a drop falls to zero. None: `effects.device_drop.threshold_a` (1 % of rated)."""
    drop_per_k: float = -0.002
    """Relative change of the drops with the devices' temperature."""
    ohm_per_k: float = 0.004
    kelvin_per_watt: NonNegative = 0.0
    """Thermal resistance from devices to heat sink, for the loss of all three legs together; 0: no heating."""
    device_time_constant_s: Positive = 2.0
    minimum_pulse_s: NonNegative = 0.0
    """Pulses shorter than this are dropped."""
    timer_s: NonNegative = 0.0
    """Resolution of the edges."""
    sampling_offset_s: float = 0.0
    """Delay of the current sampling after the carrier's turning point; negative: before it."""
    bus: Bus = Bus()


class PhaseSensors(Strict):
    """Errors of the phase-current sensors beside noise, gain and offset of sensors a and b."""

    gain_c_minus_1: float = 0.0
    """Gain error of the third sensor, on a drive that has three."""
    offset_c_a: float = 0.0
    drift_a_per_sqrt_s: NonNegative = 0.0
    """Random walk of each offset: standard deviation after one second."""
    even_per_a: float = 0.0
    """Each sensor reads i + k i^2."""
    remanence_a: NonNegative = 0.0
    """Remanent reading of a Hall sensor's core after a large current of one sign."""
    bits: Annotated[int, Field(ge=8, le=24)] | None = None
    """Resolution of the converter, instead of `quantum_a`; readings saturate at the full scale."""
    full_scale_a: Positive | None = None
    """None: four times the rated current."""
