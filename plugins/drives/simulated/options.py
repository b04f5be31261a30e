"""Options of the simulated drive: the drive as a user configures it, and the plant, which is sealed.

Omitted values are scaled from the nameplate, so that the same options serve a motor of any size.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from plugins.drives.simulated.effects import Damper, Effects
from plugins.drives.simulated.switching import PhaseSensors, Switching
from protocols import NonNegative, Positive, Strict

MAX_SUBSTEPS = 10_000
"""Integration steps a sample beyond which a simulation would not end; the stiffest plants in use need some dozens."""
Fall = Annotated[float, Field(ge=0, le=0.65)]
"""Relative fall of an inductance; the polynomial's form reaches about 0.8."""


class NameplateMagnetics(Strict):
    """The paper's polynomial energy, scaled to the nameplate and to a specified saturation."""

    kind: Literal["nameplate"] = "nameplate"
    d_fall: Fall = 0.35
    """Relative fall of L_dd at 1.25 times the rated current on +d."""
    q_fall: Fall = 0.4
    """Relative fall of L_qq at 1.25 times the rated current on q."""
    cross: Annotated[float, Field(ge=0, le=0.2)] = 0.1
    """|L_dq| / sqrt(L_d L_q) at the rated current at 45 degrees."""


class PolynomialMagnetics(Strict):
    """The paper's polynomial energy with its coefficients given, in A, Wb and H.

    H = x^2/(2 L_d) + y^2/(2 L_q) + a30 x^3 + a12 x y^2 + a40 x^4 + a22 x^2 y^2 + a04 y^4 +
    a60 x^6 + a06 y^6 with x = psi_d - psi_M and y = psi_q. L_d, L_q and psi_M default to
    the nameplate's.
    """

    kind: Literal["polynomial"]
    d_inductance_h: Positive | None = None
    q_inductance_h: Positive | None = None
    pm_flux_wb: NonNegative | None = None
    a30: float = 0.0
    a12: float = 0.0
    a40: NonNegative = 0.0
    a22: NonNegative = 0.0
    a04: NonNegative = 0.0
    a60: NonNegative = 0.0
    a06: NonNegative = 0.0


class MapMagnetics(Strict):
    """A flux map of a real machine: one that comes with the package, by name, or a file."""

    kind: Literal["map"]
    name: str | None = None
    """Name of a map of the package; an unknown name is refused with the list of names."""
    file: Path | None = None
    """Any format of `--model` (docs/export.md), half planes and holes included; rotated to put the magnet on d."""

    @model_validator(mode="after")
    def _one_source(self) -> MapMagnetics:
        if (self.name is None) == (self.file is None):
            raise ValueError("give either name or file")
        return self


Magnetics = Annotated[NameplateMagnetics | PolynomialMagnetics | MapMagnetics, Field(discriminator="kind")]


class Rotor(Strict):
    """Mechanics of the free rotor; omitted values are scaled from the rated torque."""

    rest_angle_rad: float | None = None
    """Electrical angle at the start. None: 0 with the brake engaged, random by the seed with it released."""
    inertia_kg_m2: Positive | None = None
    viscous_nm_s: NonNegative | None = None
    coulomb_nm: NonNegative | None = None
    encoder_ratio: float = 1.0
    """Measured over true electrical angle: -1 with two phases exchanged, 2 with twice the pole pairs."""


class Brake(Strict):
    """The brake of the test bench."""

    start: Literal["engaged", "released"] = "engaged"
    works: bool = True
    """False: it never engages."""
    slip_torque_nm: Positive | None = None
    """Torque above which the brake slips. None: it never slips."""


class Sensors(PhaseSensors):
    """Noise and resolution of the phase-current sensors; `PhaseSensors` applies to a switched inverter only."""

    noise_a: NonNegative | None = None
    """Standard deviation. None: 0.17 % of the rated current."""
    quantum_a: NonNegative | None = None
    """Resolution; 0: continuous. None: 0.04 % of the rated current."""


class Plant(Strict):
    """True motor, brake, inverter and sensors, hidden from every analysis."""

    magnetics: Magnetics = NameplateMagnetics()
    model: Path | None = None
    """A `model.json` whose map, R_s and effects replace the plant's."""
    resistance_ohm: Positive | None = None
    """R_s at the start of the experiment. None: that of the map of the package, else the nameplate's."""
    rotor: Rotor = Rotor()
    brake: Brake = Brake()
    sensors: Sensors = Sensors()
    effects: Effects = Effects()
    damper: Damper | None = None
    inverter: Literal["averaged", "switched"] = "averaged"
    """Averaged: one voltage per sample (fast). Switched: every edge of the bridge."""
    switching: Switching = Switching()
    """Options of the switched inverter."""
    substeps: Annotated[int, Field(ge=1, le=MAX_SUBSTEPS)] | None = None
    """Integration steps per sample. None: as many as the fastest time constant requires."""


class Fault(Strict):
    """A fault that occurs once: in an excitation by its number (from 1), or at a time of the drive's clock."""

    kind: Literal["lost_link", "stuck", "slow", "wrong_data", "trip", "exception", "interlock"]
    """interlock: all inputs open and stay open; the drive does not trip by itself."""
    at_excitation: Annotated[int, Field(ge=1)] | None = None
    at_s: NonNegative | None = None
    after_s: NonNegative = 0.0
    """Simulated time within the excitation, settling included (with `at_excitation`)."""
    timeout_s: NonNegative = 1.0
    """stuck: wall time until the drive reports no answer."""
    sleep_s: NonNegative = 0.5
    """slow: additional wall time of the block."""
    data: Literal["nan", "huge", "shape", "gap"] = "nan"
    """wrong_data: kind of corruption of the block."""
    cause: Literal["overcurrent", "overtemperature", "bus_voltage", "internal"] = "internal"
    """trip: cause that the drive reports."""

    @model_validator(mode="after")
    def _one_moment(self) -> Fault:
        if (self.at_excitation is None) == (self.at_s is None):
            raise ValueError("give either at_excitation or at_s")
        return self


class SimulatedOptions(Strict):
    """Options of the drive; `plant` is sealed."""

    sampling_frequency_hz: Positive = 10_000.0
    pwm_frequency_hz: Positive | None = None
    """None: the sampling frequency."""
    pwm_frequencies_hz: tuple[Positive, ...] | None = None
    """Supported PWM frequencies. None: 0.5, 1 and 2 times the drive's own."""
    dc_bus_voltage_v: Positive | None = None
    """None: a bus that provides twice the rated voltage."""
    voltage_delay_samples: Annotated[float, Field(ge=0, le=3)] = 0.0
    current_sensors: Literal[2, 3] = 2
    """Three (with `plant.inverter: switched`): all are recorded and enter the Clarke transform."""
    current_sampling: Literal["turning_point", "averaged"] = "turning_point"
    """At the carrier's turning point, or the mean since the last row (declared delay: half a sample longer)."""
    thermometer: bool = False
    """Records the winding temperature with the currents (constant 20 degrees without `effects.winding_heating`)."""
    max_current_a: Positive | None = None
    """None: 2.5 times the rated current, or the end of the flux map if that is less."""
    max_voltage_v: Positive | None = None
    """None: the bus voltage over sqrt(3), available in every direction."""
    trip_ratio: Annotated[float, Field(gt=1)] = 1.2
    """Overcurrent trip level over the current limit of the experiment."""
    overload_s: Positive | None = None
    """Trip level of the time integral of (i / rated)^2 - 1. None: no overload protection."""
    longest_capture_s: Positive | None = None
    watchdog_s: Positive | None = 0.2
    """Wall time; None: no watchdog."""
    gap_s: NonNegative = 0.0
    """Time on the drive's clock between two excitations, at the operating point."""
    has_brake: bool = True
    """Whether the drive controls the brake; otherwise the brake keeps its initial state."""
    interlocks: tuple[str, ...] = ()
    """Names of interlock inputs; closed except during a fault."""
    realtime_factor: Positive | None = None
    """Simulated time over wall time. None: as fast as possible."""
    faults: tuple[Fault, ...] = ()
    plant: Plant = Plant()
