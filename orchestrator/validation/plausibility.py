"""Plausibility bounds for nameplates, settings and waveforms, which reveal a wrong unit or a typing error.

The bounds are wide: poor drives, sensors and motors are within them. The quality of a measurement is checked
elsewhere.
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
"""In the fields' units: from a watch's motor to a ship's, with some decades of margin."""
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
"""Units in which nameplate values are written by mistake, and the factor to the field's unit."""
DRIVE_RANGES: Mapping[str, Range] = {
    "sampling_frequency_hz": (1.0, 1e6),
    "pwm_frequency_hz": (100.0, 1e6),
}
"""Options that mean the same in every drive; a board that answers single reads samples from 1 Hz on."""
MAX_LIMIT_RATIO = 50.0
"""Limit of a procedure over the motor's rated peak; drives overload a motor up to five times."""
TWO_TURNS_RAD = 4.0 * math.pi
"""Largest plausible angle; values in degrees are mostly larger."""
MAX_VOLTAGE_RATIO = 2.0 / 3.0
"""Longest voltage vector of a bridge, in bus voltages: the hexagon's corner."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of waveforms, all relative.

    Attributes
    ----------
    rated_currents : (float, float)
        Largest current over the rated one.
    bus_voltages : (float, float)
        Largest voltage vector over the nominal bus voltage. A bridge gives 2/3; controllers that saturate late command
        more, and held currents need little.
    bus : (float, float)
        Measured bus voltage over the nominal one.
    resistance : (float, float)
        Voltage over current, relative to the nameplate's R_s. At small currents dead time looks like many R_s.
    inductance : (float, float)
        Inductance from the ripple over the nameplate's.
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
"""Outside these an import questions the mapping: a factor of a thousand shows on any bench."""
POSSIBLE_BOUNDS = Bounds(
    rated_currents=(0.0, 50.0),
    bus_voltages=(2e-5, 10.0),
    bus=(0.02, 20.0),
    resistance=(0.02, 1000.0),
    inductance=(0.01, 100.0),
)
"""Outside these a recording is refused; five rated currents with a gain wrong by ten are accepted."""


def within(value: float, bounds: Range, unit: float = 1.0) -> bool:
    """Whether a value lies in a range that is given in some unit."""
    return bounds[0] * unit <= value <= bounds[1] * unit


def outside(values: Mapping[str, Any], ranges: Mapping[str, Range], why: str) -> Iterator[tuple[str, str]]:
    """Name and problem of every value out of its range; absent values are skipped."""
    for name, (low, high) in ranges.items():
        value = values.get(name)
        if isinstance(value, int | float) and not low <= value <= high:
            yield name, f"{value:g} is not between {low:g} and {high:g}: {why}"


def implausible(
    procedure: Procedure, stages: Sequence[Stage], longest_s: float = 86_400.0
) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Key path and problem of every implausible number in a procedure; times of a stage are below `longest_s`."""
    for name, problem in outside(procedure.motor.model_dump(), MOTOR_RANGES, "no motor has that"):
        yield ("motor", name), problem + _other_unit(name, procedure.motor)
    for name, problem in outside(procedure.drive.options, DRIVE_RANGES, "no drive does that"):
        yield ("drive", name), problem
    yield from _limits_beyond_nameplate(procedure)
    for index, stage in enumerate(stages):
        for name, value in stage:
            if name.endswith("_rad") and isinstance(value, float) and abs(value) > TWO_TURNS_RAD:
                degrees = f"is it in degrees ({math.radians(value):.4g} rad)?"
                yield ("stages", index, name), f"{value:g} rad is more than two turns: {degrees}"
            if name.endswith("_s") and isinstance(value, float) and value > longest_s:
                yield ("stages", index, name), f"{value:g} s is more than a day"


def _limits_beyond_nameplate(procedure: Procedure) -> Iterator[tuple[tuple[str, str], str]]:
    """Key path and problem of a limit that exceeds the rated value so far that one of the two has another unit."""
    limits, motor = procedure.limits, procedure.motor
    for name, limit, field, unit, peak_over_rms in (
        ("current_a", limits.current_a, "rated_current_rms_a", "A", math.sqrt(2.0)),
        ("voltage_v", limits.voltage_v, "rated_voltage_rms_v", "V", math.sqrt(2.0 / 3.0)),
    ):
        rated = getattr(motor, field)
        if rated and limit > MAX_LIMIT_RATIO * peak_over_rms * rated:
            ratio = limit / (peak_over_rms * rated)
            rest = f"the rated peak (motor.{field} is {rated:g} {unit}): one of the two is in another unit"
            yield ("limits", name), f"{limit:g} {unit} is {ratio:.0f} times {rest}"


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
"""Slow part of a waveform's voltage over the whole below which it is a rounding of whole periods."""
MIN_OHMIC_RATIO = 0.3
"""Voltage over R_s i below which their angle has no meaning: the current only decays."""


def suspicious_phase_rad(
    vi_mean: complex, v_squared: float, i_squared: float, min_coherence: float = 0.5, min_ohm: float = 0.0
) -> float | None:
    """Angle between voltage and current where it is impossible for a winding; None for a normal passive load.

    Parameters
    ----------
    vi_mean : complex
        Mean of conj(i) v.
    v_squared, i_squared : float
        Means of the squares.
    min_coherence : float
        Smallest coherence of voltage and current for a meaningful angle, at most 1.
    min_ohm : float
        Smallest voltage over current for a meaningful angle.

    Returns
    -------
    float or None
        Beyond 60 degrees, where a winding at standstill would be more inductor than resistor [rad].
    """
    angle = math.atan2(vi_mean.imag, vi_mean.real)
    size = math.sqrt(v_squared * i_squared)
    is_meaningful = v_squared > min_ohm**2 * i_squared and abs(vi_mean) > min_coherence * size
    return angle if is_meaningful and size > 0.0 and abs(angle) > math.pi / 3.0 else None


def is_reversed(angle_rad: float) -> bool:
    """Whether two vectors at this angle are opposite; exchanged phases give a smaller angle."""
    return abs(angle_rad) > 2.6
