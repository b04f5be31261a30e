"""What no motor has and no test bench does: bounds for numbers that are slips of a unit or of the keyboard.

Shared by whatever takes in nameplates, settings and waveforms. The bounds are wide: drives, sensors and motors may be
as bad as they like, and whether a measurement is good is not judged here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocols import Motor, Procedure, Stage

Numbers = NDArray[np.floating[Any]]
Range = tuple[float, float]
_Real = TypeVar("_Real", bound=np.floating[Any])

MOTOR_RANGES: Mapping[str, Range] = {
    "pole_pairs": (1, 500),
    "rated_power_w": (1e-3, 1e9),
    "rated_voltage_rms_v": (0.1, 1e5),
    "rated_current_rms_a": (1e-3, 1e5),
    "rated_frequency_hz": (0.01, 1e5),
    "rated_speed_rpm": (0.01, 1e7),
    "rated_torque_nm": (1e-7, 1e8),
    "stator_resistance_ohm": (1e-6, 1e5),
    "stator_resistance_std_ohm": (1e-9, 1e5),
    "d_inductance_h": (1e-8, 10.0),
    "q_inductance_h": (1e-8, 10.0),
    "pm_flux_wb": (0.0, 100.0),
}
"""In the fields' own units: from the smallest watch's motor to the largest ship's, and some decades more."""
_INDUCTANCE_UNITS = (("mH", 1e-3), ("uH", 1e-6))
OTHER_UNITS: Mapping[str, Sequence[tuple[str, float]]] = {
    "d_inductance_h": _INDUCTANCE_UNITS,
    "q_inductance_h": _INDUCTANCE_UNITS,
    "stator_resistance_ohm": (("milliohm", 1e-3),),
    "pm_flux_wb": (("mWb", 1e-3),),
    "rated_power_w": (("kW", 1e3),),
    "rated_voltage_rms_v": (("kV", 1e3),),
    "rated_current_rms_a": (("mA", 1e-3),),
    "rated_torque_nm": (("mNm", 1e-3),),
}
"""Units that a nameplate's values are written in by mistake, and how many of the field's own they are."""
DRIVE_RANGES: Mapping[str, Range] = {
    "sampling_frequency_hz": (1.0, 1e6),
    "pwm_frequency_hz": (100.0, 1e6),
}
"""Options that mean the same in every drive; a board that answers single reads samples from 1 Hz on."""
TWO_TURNS_RAD = 4.0 * math.pi
"""Angles as they are written are less; degrees are mostly more."""
MAX_VOLTAGE_RATIO = 2.0 / 3.0
"""Longest voltage vector of a bridge, in bus voltages: the hexagon's corner."""


@dataclass(frozen=True)
class Bounds:
    """How small and how large waveforms may be; all without a unit.

    Attributes
    ----------
    rated_currents : (float, float)
        The largest current, in rated ones.
    bus_voltages : (float, float)
        The largest voltage vector, in nominal bus voltages. A bridge makes 2/3; controllers that saturate late command
        more, and currents that are held ask for little.
    bus : (float, float)
        The measured bus voltage, in nominal ones.
    resistance : (float, float)
        Voltage over current, in the nameplate's R_s. At small currents dead time passes for many times it.
    inductance : (float, float)
        What the ripple shows, in the nameplate's.
    """

    rated_currents: Range
    bus_voltages: Range
    bus: Range
    resistance: Range
    inductance: Range


PLAUSIBLE_BOUNDS = Bounds(
    rated_currents=(0.01, 20.0),
    bus_voltages=(2e-4, 5.0),
    bus=(0.3, 3.0),
    resistance=(0.02, 100.0),
    inductance=(0.01, 100.0),
)
"""Beyond these an import questions the mapping: a slip of a thousand shows, whatever the bench."""
POSSIBLE_BOUNDS = Bounds(
    rated_currents=(0.0, 50.0),
    bus_voltages=(2e-5, 10.0),
    bus=(0.02, 20.0),
    resistance=(0.02, 1000.0),
    inductance=(0.01, 100.0),
)
"""Beyond these a recording is refused: five rated currents under a gain that is wrong by ten pass."""


def within(value: float, bounds: Range, unit: float = 1.0) -> bool:
    """Whether a value lies in a range that is given in some unit."""
    return bounds[0] * unit <= value <= bounds[1] * unit


def outside(values: Mapping[str, Any], ranges: Mapping[str, Range], why: str) -> Iterator[tuple[str, str]]:
    """Name and problem of every value out of its range; what is absent is not looked at."""
    for name, (low, high) in ranges.items():
        value = values.get(name)
        if isinstance(value, int | float) and not low <= value <= high:
            yield name, f"{value:g} is not between {low:g} and {high:g}: {why}"


def implausible(
    procedure: Procedure, stages: Sequence[Stage], longest_s: float = 86_400.0
) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Key path and problem of every number in a procedure that cannot be meant; no time of a stage is above a day."""
    for name, problem in outside(procedure.motor.model_dump(), MOTOR_RANGES, "no motor has that"):
        yield ("motor", name), problem + _other_unit(name, procedure.motor)
    for name, problem in outside(procedure.drive.options, DRIVE_RANGES, "no drive does that"):
        yield ("drive", name), problem
    for index, stage in enumerate(stages):
        for name, value in stage:
            if name.endswith("_rad") and isinstance(value, float) and abs(value) > TWO_TURNS_RAD:
                degrees = f"is it in degrees ({math.radians(value):.4g} rad)?"
                yield ("stages", index, name), f"{value:g} rad is more than two turns: {degrees}"
            if name.endswith("_s") and isinstance(value, float) and value > longest_s:
                yield ("stages", index, name), f"{value:g} s is more than a day"


def _other_unit(name: str, motor: Motor) -> str:
    """The unit that would take a nameplate's value into its range, as a question; empty where none does."""
    value = getattr(motor, name)
    fitting = (
        (unit, factor) for unit, factor in OTHER_UNITS.get(name, ()) if within(factor * value, MOTOR_RANGES[name])
    )
    unit, factor = next(fitting, ("", 0.0))
    if not unit:
        return ""
    ohm, si = motor.stator_resistance_ohm, name.rpartition("_")[2]
    time_constant = f" (L / R = {value / ohm:.3g} s)" if si == "h" and ohm else ""
    return f"{time_constant}: is it in {unit}? Then write {factor * value:.4g}"


def rms(x: Numbers) -> float:
    """Root of the mean square; of vectors (n, 2), of their length."""
    return math.sqrt(float(np.mean(np.square(x))) * (x.shape[1] if x.ndim == 2 else 1))


def slow_part(x: NDArray[_Real], rate_hz: float, window_s: float = 0.02) -> NDArray[_Real]:
    """Means over windows, which hold several periods of an injection; vectors (n, 2) to (m, 2)."""
    window = min(max(round(window_s * rate_hz), 1), len(x))
    windows = len(x) // window
    means: NDArray[_Real] = x[: windows * window].reshape(windows, window, 2).mean(axis=1)
    return means


MIN_SLOW_VOLTAGE_RATIO = 1e-3
"""Slow part of a waveform's voltage over the whole, below which it is a remainder of whole periods."""
MIN_OHMIC_RATIO = 0.3
"""Voltage over current, in R_s, below which their angle means nothing: the current only decays."""


def apart_rad(
    v_on_i: complex, v_squared: float, i_squared: float, alike: float = 0.5, least_ohm: float = 0.0
) -> float | None:
    """Angle between voltage and current where it says that one is wrong; None where a winding takes the power.

    Parameters
    ----------
    v_on_i : complex
        Mean of conj(i) v.
    v_squared, i_squared : float
        Means of the squares.
    alike : float
        Share of the voltage that has to go with the current for their angle to mean anything; 1 is all of it.
    least_ohm : float
        Voltage over current that there has to be for the same.

    Returns
    -------
    float or None
        Beyond 60 degrees: at that a winding would have to be more inductor than resistor at standstill.
    """
    angle = math.atan2(v_on_i.imag, v_on_i.real)
    size = math.sqrt(v_squared * i_squared)
    tells = v_squared > least_ohm**2 * i_squared and abs(v_on_i) > alike * size
    return angle if tells and size > 0.0 and abs(angle) > math.pi / 3.0 else None


def is_reversed(angle_rad: float) -> bool:
    """Whether two vectors this far apart are each other's negative; exchanged phases put them less far apart."""
    return abs(angle_rad) > 2.6
