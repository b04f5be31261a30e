"""Options of the switched inverter and of the sensors of a drive that has one; nothing is computed here."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols import NonNegative, Positive, Strict


class Bus(Strict):
    """The DC bus behind the bridge."""

    resistance_ohm: NonNegative = 0.0
    """Of the source."""
    capacitance_f: NonNegative = 0.0
    """Across the bridge; 0: the bus follows its load at once."""
    logged: Literal["measured", "nominal"] = "measured"
    """Whether rows and telemetry hold what the drive measures, or the nominal voltage repeated."""
    gain: Annotated[float, Field(gt=0.5, lt=1.5)] = 1.0
    """Measured over true voltage."""
    compensated: bool = False
    """Whether the drive divides by what it measures when it makes duties of voltages, or by the nominal voltage."""


class Switching(Strict):
    """An inverter of three legs on a symmetric carrier, edge by edge.

    An edge waits for the dead time where the phase current holds the node. Where the current drives the node itself,
    it charges the capacitances of both devices, dv/dt = i / (2 C), and what the dead time costs fades towards zero
    current: t_d - C V / i in all. What decides is the current at the edge, its ripple included.

    `dead_time`, `device_drop`, `bus_sag` and `voltage_delay` among the plant's effects are taken as the averaged sizes
    of the same things, for those that are not given here.
    """

    dead_time_s: NonNegative | tuple[NonNegative, NonNegative, NonNegative] | None = None
    """Of all legs, or of each. None: what loses `effects.dead_time.voltage_v` at the drive's own PWM frequency."""
    output_capacitance_f: NonNegative | None = None
    """Of one device. None: what makes the dead time fade below `effects.dead_time.threshold_a` (4 % of rated)."""
    grading: Annotated[float, Field(ge=0.0, le=0.8)] = 0.0
    """By which power the capacitances fall with the voltage across them: 1/2 for an abrupt junction; 0: they do not.
    `output_capacitance_f` is then what takes the same charge from rail to rail."""
    switch_drop_v: NonNegative | None = None
    """At zero current. None: `effects.device_drop.voltage_v`."""
    switch_ohm: NonNegative | None = None
    diode_drop_v: NonNegative | None = None
    """None: as the switch."""
    diode_ohm: NonNegative | None = None
    drop_knee_a: Positive | None = None
    """Below it a drop falls to zero. None: `effects.device_drop.threshold_a` (1 % of the rated current)."""
    drop_per_k: float = -0.002
    """Relative change of the drops with the devices' heat."""
    ohm_per_k: float = 0.004
    kelvin_per_watt: NonNegative = 0.0
    """Devices over heat sink, for the loss of all three legs together; 0: they stay cold."""
    device_time_constant_s: Positive = 2.0
    minimum_pulse_s: NonNegative = 0.0
    """Pulses shorter than that are left out."""
    timer_s: NonNegative = 0.0
    """Resolution of the edges."""
    sampling_offset_s: float = 0.0
    """By how much the currents are sampled after the carrier's turning point; negative: before."""
    bus: Bus = Bus()


class PhaseSensors(Strict):
    """What each phase-current sensor adds to the two sensors' noise, gain and offset."""

    gain_c_minus_1: float = 0.0
    """Of the third sensor, on a drive that has three."""
    offset_c_a: float = 0.0
    drift_a_per_sqrt_s: NonNegative = 0.0
    """Each offset's random walk: standard deviation after a second."""
    even_per_a: float = 0.0
    """Each sensor reads i + k i^2."""
    remanence_a: NonNegative = 0.0
    """What a Hall sensor's core keeps after a large current of one sign."""
    bits: Annotated[int, Field(ge=8, le=24)] | None = None
    """Of the converter, instead of `quantum_a`; readings end at the full scale."""
    full_scale_a: Positive | None = None
    """None: four times the rated current."""
