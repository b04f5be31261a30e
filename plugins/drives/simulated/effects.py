"""Options of the plant's effects: one model per effect, named as in the catalogue.

`_plant`, `_iron` and `_sensing` compute the effects.
An effect that is not given is absent.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols import NonNegative, Positive, Strict


class DeadTime(Strict):
    """Voltage lost in each phase against the sign of its current, in proportion to the PWM frequency."""

    voltage_v: NonNegative
    """At the drive's own PWM frequency."""
    threshold_a: Positive | None = None
    """Phase current below which the dead-time voltage fades. None: 4 % of the rated current."""


class DeviceDrop(Strict):
    """Forward drop of the switches, at any PWM frequency."""

    voltage_v: NonNegative
    threshold_a: Positive | None = None
    """Width of the knee. None: 1 % of the rated current."""
    on_resistance_ohm: NonNegative = 0.0


class BusSag(Strict):
    """Impressed voltage v (1 - per_watt P), P being the power drawn from the bus."""

    per_watt: float


class VoltageDelay(Strict):
    """The voltage acts later than the drive declares, by this time."""

    delay_s: NonNegative


class CurrentFilter(Strict):
    """First-order lag of each phase's current sensor."""

    time_constant_s: NonNegative


class CurrentGainMismatch(Strict):
    """Gains 1 + g/2 of sensor a and 1 - g/2 of sensor b."""

    gain_a_minus_b: float


class PhaseResistanceImbalance(Strict):
    """Extra ohms in phases a and b; phase c has none."""

    extra_a_ohm: NonNegative = 0.0
    extra_b_ohm: NonNegative = 0.0


class CurrentOffset(Strict):
    """Offsets of the sensors of phases a and b (i_c = -i_a - i_b)."""

    offset_a_a: float = 0.0
    offset_b_a: float = 0.0


class VoltageBias(Strict):
    """Constant voltage lost in phases a and b (that of c follows from the star connection)."""

    bias_a_v: float = 0.0
    bias_b_v: float = 0.0


class CurrentNonlinearity(Strict):
    """Each sensor reads i + k i^3."""

    cubic_per_a2: float


class WindingHeating(Strict):
    """R = R_0 (1 + y), y following rise_per_watt times the copper loss through a thermal lag.

    The rises of housing and ambient, where they warm as well, are added to the winding's.
    """

    rise_per_watt: float
    time_constant_s: Positive = 300.0
    housing_rise_per_watt: NonNegative = 0.0
    """Second, slower rise, of the housing."""
    housing_time_constant_s: Positive = 1800.0
    ambient_rise_per_s: float = 0.0
    """Relative change of R per second by the ambient temperature, at any current."""


class SkinEffect(Strict):
    """Extra resistance for current components above a corner frequency."""

    extra_ohm: NonNegative
    corner_hz: Positive = 60.0


class EddyCurrents(Strict):
    """Stator current = magnetising current + (dpsi/dt) / core_loss_ohm.

    With a time constant the current follows that through a lag, an inductance beside the resistance,
    and the loss falls with frequency.
    """

    core_loss_ohm: Positive
    core_loss_q_ohm: Positive | None = None
    """Core loss resistance of the q axis. None: as on d."""
    time_constant_s: Positive | None = None
    """None: no lag with an averaged inverter, one sampling period with a switched one."""


class Damper(Strict):
    """A closed winding on one axis (a sleeve, a cage, conducting magnets): current (dpsi/dt) / ohm through a lag."""

    axis: Literal["d", "q"]
    ohm: Positive
    time_constant_s: Positive = 5e-3


class Hysteresis(Strict):
    """Three vector stop operators of the flux beside the reversible current.

    The stops add up to `half_width_a` when all slide, and make the inductance of small loops
    `reversible_ratio` times that of large ones.
    """

    half_width_a: NonNegative
    reversible_ratio: Annotated[float, Field(gt=0.5, le=1.0)] = 0.93
    q_over_d: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Ratio of the widths along q and d."""


class RotorMisalignment(Strict):
    """True minus believed electrical angle after the brake has engaged and turned the shaft."""

    angle_rad: float


class BrakeCompliance(Strict):
    """The locked rotor twists by rad_per_nm T_e (electrical), with a lag; backlash is passed at T_e = 0.

    With a resonance the rotor oscillates on the shaft's spring instead (torsion of second order).
    """

    rad_per_nm: NonNegative
    lag_s: Positive = 1e-3
    backlash_rad: NonNegative = 0.0
    resonance_hz: Annotated[float, Field(gt=0, le=2000)] | None = None
    """None: no resonance, the lag alone."""
    damping: Annotated[float, Field(gt=0, le=5)] = 0.05
    """Damping ratio of the resonance (1: critical)."""


class MagnetHeating(Strict):
    """The magnet flux changes by flux_change_wb, exponentially in time."""

    flux_change_wb: float
    time_constant_s: Positive = 300.0


class SlotHarmonics(Strict):
    """A saliency of `relative` (of the mean inductance) that turns `order` times with the rotor angle."""

    relative: float
    order: Annotated[int, Field(ge=1)] = 6
    phase_rad: float = 0.7853981633974483


class Effects(Strict):
    """Every effect of the catalogue; saturation and cross-saturation belong to the magnetics."""

    dead_time: DeadTime | None = None
    device_drop: DeviceDrop | None = None
    bus_sag: BusSag | None = None
    voltage_delay: VoltageDelay | None = None
    current_filter: CurrentFilter | None = None
    current_gain_mismatch: CurrentGainMismatch | None = None
    phase_resistance_imbalance: PhaseResistanceImbalance | None = None
    current_offset: CurrentOffset | None = None
    voltage_bias: VoltageBias | None = None
    current_nonlinearity: CurrentNonlinearity | None = None
    winding_heating: WindingHeating | None = None
    skin_effect: SkinEffect | None = None
    eddy_currents: EddyCurrents | None = None
    hysteresis: Hysteresis | None = None
    rotor_misalignment: RotorMisalignment | None = None
    brake_compliance: BrakeCompliance | None = None
    magnet_heating: MagnetHeating | None = None
    slot_harmonics: SlotHarmonics | None = None
