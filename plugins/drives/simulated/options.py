"""Options of the simulated drive: the drive as a user sees it, and the plant, which is sealed.

Sizes that are left out are scaled from the nameplate, so that the same options serve a motor of
any size. Nothing is computed here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from plugins.drives.simulated.effects import Damper, Effects
from plugins.drives.simulated.switching import PhaseSensors, Switching
from protocols import NonNegative, Positive, Strict

Fall = Annotated[float, Field(ge=0, le=0.65)]


class NameplateMagnetics(Strict):
    """The paper's polynomial energy, scaled so that the nameplate's motor saturates as motors do."""

    kind: Literal["nameplate"] = "nameplate"
    d_fall: Fall = 0.35
    """How much L_dd has fallen at 1.25 times the rated current on +d."""
    q_fall: Fall = 0.4
    """How much L_qq has fallen at 1.25 times the rated current on q."""
    cross: Annotated[float, Field(ge=0, le=0.2)] = 0.1
    """|L_dq| / sqrt(L_d L_q) at the rated current at 45 degrees."""


class PolynomialMagnetics(Strict):
    """The paper's polynomial energy with its coefficients given, in A, Wb and H.

    H = x^2/(2 L_d) + y^2/(2 L_q) + a30 x^3 + a12 x y^2 + a40 x^4 + a22 x^2 y^2 + a04 y^4 +
    a60 x^6 + a06 y^6 with x = psi_d - psi_M and y = psi_q; what is left out of the first three is
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
    """Without it and without a file: an error that lists the names."""
    file: Path | None = None
    """Whatever `--model` reads (docs/export.md), half planes and holes included; turned until the magnet lies on d."""

    @model_validator(mode="after")
    def _one_source(self) -> MapMagnetics:
        if (self.name is None) == (self.file is None):
            raise ValueError("give either name or file")
        return self


Magnetics = Annotated[NameplateMagnetics | PolynomialMagnetics | MapMagnetics, Field(discriminator="kind")]


class Rotor(Strict):
    """The mechanics of a rotor that may turn; left out, they are scaled from the rated torque."""

    rest_angle_rad: float | None = None
    """Electrical angle at the start. None: 0 with the brake engaged, from the seed where released."""
    inertia_kg_m2: Positive | None = None
    viscous_nm_s: NonNegative | None = None
    coulomb_nm: NonNegative | None = None
    encoder_ratio: float = 1.0
    """Of the drive's electrical turns to the true ones: -1 with two phases exchanged, 2 with twice the pole pairs."""


class Brake(Strict):
    """The brake of the test bench."""

    start: Literal["engaged", "released"] = "engaged"
    works: bool = True
    """False: it never engages, whatever the command."""
    slip_torque_nm: Positive | None = None
    """Torque above which it slips. None: never."""


class Sensors(PhaseSensors):
    """The phase-current sensors' noise and resolution; what `PhaseSensors` adds is there on a switched inverter."""

    noise_a: NonNegative | None = None
    """Standard deviation. None: 0.17 % of the rated current."""
    quantum_a: NonNegative | None = None
    """0: none. None: 0.04 % of the rated current."""


class Plant(Strict):
    """Motor, brake, inverter and sensors as they truly are. No analysis may see any of it."""

    magnetics: Magnetics = NameplateMagnetics()
    model: Path | None = None
    """A `model.json` whose map, R_s and effects the plant has, instead of its own."""
    resistance_ohm: Positive | None = None
    """At the start of the experiment. None: the nameplate's (the map's own for a map of the package)."""
    rotor: Rotor = Rotor()
    brake: Brake = Brake()
    sensors: Sensors = Sensors()
    effects: Effects = Effects()
    damper: Damper | None = None
    inverter: Literal["averaged", "switched"] = "averaged"
    """Averaged: one voltage a sample, fast. Switched: every edge, and what follows from it."""
    switching: Switching = Switching()
    """Of the switched inverter."""
    substeps: Annotated[int, Field(ge=1)] | None = None
    """Steps of the integration in a sample. None: as many as the fastest time constant asks for."""


class Fault(Strict):
    """One way to fail, once: in an excitation by its number (from 1), or at a time of the drive's clock."""

    kind: Literal["lost_link", "stuck", "slow", "wrong_data", "trip", "exception", "interlock"]
    """interlock: all of the drive's inputs open, and stay so; it does not trip by itself."""
    at_excitation: Annotated[int, Field(ge=1)] | None = None
    at_s: NonNegative | None = None
    after_s: NonNegative = 0.0
    """Simulated time within the excitation, settling included (with `at_excitation`)."""
    timeout_s: NonNegative = 1.0
    """stuck: wall time until the drive is given up."""
    sleep_s: NonNegative = 0.5
    """slow: wall time that the block takes longer."""
    data: Literal["nan", "huge", "shape", "gap"] = "nan"
    """wrong_data: what is wrong with the block."""
    cause: Literal["overcurrent", "overtemperature", "bus_voltage", "internal"] = "internal"
    """trip: what the drive says."""

    @model_validator(mode="after")
    def _one_moment(self) -> Fault:
        if (self.at_excitation is None) == (self.at_s is None):
            raise ValueError("give either at_excitation or at_s")
        return self


class SimulatedOptions(Strict):
    """The drive as its user configures it; `plant` is sealed."""

    sampling_frequency_hz: Positive = 10_000.0
    pwm_frequency_hz: Positive | None = None
    """None: the sampling frequency."""
    pwm_frequencies_hz: tuple[Positive, ...] | None = None
    """All supported ones. None: half, once and twice the drive's own."""
    dc_bus_voltage_v: Positive | None = None
    """None: what gives twice the rated voltage."""
    voltage_delay_samples: Annotated[float, Field(ge=0, le=3)] = 0.0
    current_sensors: Literal[2, 3] = 2
    """Three: all are recorded, and the vector is the Clarke transform of all (with `plant.inverter: switched`)."""
    current_sampling: Literal["turning_point", "averaged"] = "turning_point"
    """Where the carrier turns, or the mean since the last row; the declared delay is half a sample longer then."""
    thermometer: bool = False
    """One in the winding, recorded with the currents (with `effects.winding_heating`, else it stays at 20 degrees)."""
    max_current_a: Positive | None = None
    """None: 2.5 times the rated current, or as far as the motor is known."""
    max_voltage_v: Positive | None = None
    """None: the longest vector that the bus gives in every direction."""
    trip_ratio: Annotated[float, Field(gt=1)] = 1.2
    """Overcurrent trip over the limit handed over when arming."""
    overload_s: Positive | None = None
    """Most of the time integral of (i / rated)^2 - 1 before the drive trips. None: no such protection."""
    longest_capture_s: Positive | None = None
    watchdog_s: Positive | None = 0.2
    """Wall time; None: no dead man."""
    gap_s: NonNegative = 0.0
    """Time on the drive's clock between two excitations, at the operating point."""
    has_brake: bool = True
    """Whether the drive moves the brake; else it stays as it started."""
    interlocks: tuple[str, ...] = ()
    """Names of interlock inputs; closed but for a fault."""
    realtime_factor: Positive | None = None
    """Pace of simulated time against the wall clock. None: as fast as possible."""
    faults: tuple[Fault, ...] = ()
    plant: Plant = Plant()
