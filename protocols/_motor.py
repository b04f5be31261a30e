"""The motor as its nameplate and data sheet describe it: what is believed before measuring."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from protocols._base import Lenient, Strict

Positive = Annotated[float, Field(gt=0)]


class Motor(Lenient):
    """Nameplate of a permanent-magnet synchronous motor, as a recording's manifest holds it.

    Star-connected values per phase; rated voltage is line to line; `_rms_` fields are rms, every
    other current, voltage and flux in the project is a peak value.
    """

    name: str
    pole_pairs: Annotated[int, Field(ge=1)]
    rated_power_w: Positive | None = None
    rated_voltage_rms_v: Positive | None = None
    rated_current_rms_a: Positive | None = None
    rated_frequency_hz: Positive | None = None
    rated_speed_rpm: Positive | None = None
    rated_torque_nm: Positive | None = None
    stator_resistance_ohm: Positive | None = None
    stator_resistance_std_ohm: Positive | None = None
    """Standard deviation of the one above, where it was measured: it is then believed that far, and no further."""
    d_inductance_h: Positive | None = None
    q_inductance_h: Positive | None = None
    pm_flux_wb: Annotated[float, Field(ge=0)] | None = None

    @property
    def rated_current_a(self) -> float | None:
        """Rated current as the length of its vector [A peak]."""
        return None if self.rated_current_rms_a is None else math.sqrt(2.0) * self.rated_current_rms_a


class ProcedureMotor(Motor, Strict):
    """The same nameplate where a person writes it: an unknown key is an error."""

    model_config = Strict.model_config

    example: bool = False
    """A motor to try things with: a drive is not energised with it unless it is simulated, or set up for that motor."""
