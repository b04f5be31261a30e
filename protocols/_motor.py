"""The motor as its nameplate and data sheet describe it: the prior of a measurement."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from protocols._base import Lenient, Strict

_SMALLEST: float = 1e-30
"""Size below which a positive number is no quantity of a motor or a plan: what divides by it overflows."""


def _not_too_small(value: float) -> float:
    if value < _SMALLEST:
        raise ValueError(f"{value:g} is too small a number")
    return value


Positive = Annotated[float, Field(gt=0), AfterValidator(_not_too_small)]


class Motor(Lenient):
    """Nameplate of a permanent-magnet synchronous motor, as a recording's manifest holds it.

    Star-connected values per phase; rated voltage is line to line; `_rms_` fields are rms, every
    other current, voltage and flux in the project is a peak value.
    """

    name: str
    """Any text; files and reports are called by it."""
    pole_pairs: Annotated[int, Field(ge=1)]
    """Pairs of poles: half the number of poles (or of magnets on the rotor). Electrical angle = pole pairs times the
    mechanical one."""
    rated_power_w: Positive | None = None
    """At the shaft (mechanical) [W, not kW]."""
    rated_voltage_rms_v: Positive | None = None
    """Line to line, rms of the fundamental [V]. Not the DC bus, not a phase's, not a peak: peak / sqrt 2."""
    rated_current_rms_a: Positive | None = None
    """Of a terminal, rms, continuous [A]. A peak value is this times sqrt 2; a winding in delta carries it / sqrt 3."""
    rated_frequency_hz: Positive | None = None
    """Electrical [Hz]: pole pairs x rpm / 60."""
    rated_speed_rpm: Positive | None = None
    """Mechanical [1/min, not rad/s]."""
    rated_torque_nm: Positive | None = None
    """At the shaft, continuous [Nm]."""
    stator_resistance_ohm: Positive | None = None
    """Of a phase of the equivalent star, at 20 to 25 degrees C [ohm, not milliohm]: half of what an ohmmeter reads
    between two terminals, in star or delta. Data sheets often state the value from line to line, which is twice it."""
    stator_resistance_std_ohm: Positive | None = None
    """Standard deviation of the one above [ohm], where it was measured: it is then believed that far and no further."""
    d_inductance_h: Positive | None = None
    """Of a phase of the equivalent star, along the magnet [H, not mH]: half of what a bridge reads between two
    terminals with the rotor there. With buried magnets the smaller of the two."""
    q_inductance_h: Positive | None = None
    """Inductance across the magnet (electrical quadrature) [H, not mH]; equal to d with surface magnets."""
    pm_flux_wb: Annotated[float, Field(ge=0)] | None = None
    """Flux linkage of the magnet with a phase, peak, of electrical angle [Wb = V s]: peak phase voltage / (2 pi f).
    From line to line volts rms per 1000 rpm, K: sqrt(2/3) x K x 60 / (2 pi x 1000 x pole pairs)."""

    @property
    def rated_current_a(self) -> float | None:
        """Rated current as the length of its vector [A peak]."""
        return None if self.rated_current_rms_a is None else math.sqrt(2.0) * self.rated_current_rms_a


class ProcedureMotor(Motor, Strict):
    """The nameplate in a hand-written file: an unknown key is an error."""

    model_config = Strict.model_config

    example: bool = False
    """A motor to try things with: a drive is not energised with it unless it is simulated, or set up for that motor."""
