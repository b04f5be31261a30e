"""What no motor has and no test bench does: bounds for numbers that are slips of a unit or of the keyboard.

Shared by whatever takes in nameplates and waveforms. The bounds are wide, and nothing is judged here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.floating[Any]]
_Real = TypeVar("_Real", bound=np.floating[Any])

MOTOR_RANGES: Mapping[str, tuple[float, float]] = {
    "pole_pairs": (1, 500),
    "rated_power_w": (1e-3, 1e9),
    "rated_voltage_rms_v": (0.1, 1e5),
    "rated_current_rms_a": (1e-3, 1e5),
    "rated_frequency_hz": (0.01, 1e5),
    "rated_speed_rpm": (0.01, 1e7),
    "rated_torque_nm": (1e-7, 1e8),
    "stator_resistance_ohm": (1e-6, 1e5),
    "d_inductance_h": (1e-8, 100.0),
    "q_inductance_h": (1e-8, 100.0),
    "pm_flux_wb": (0.0, 100.0),
}
DRIVE_RANGES: Mapping[str, tuple[float, float]] = {
    "sampling_frequency_hz": (100.0, 1e6),
    "pwm_frequency_hz": (100.0, 1e6),
}
"""What means the same in every drive that has it."""
HEXAGON = 2.0 / 3.0
"""Longest voltage vector of a bridge, in bus voltages."""

_SLOW_S = 0.02


def outside(
    values: Mapping[str, Any], ranges: Mapping[str, tuple[float, float]], why: str
) -> Iterator[tuple[str, str]]:
    """Name and problem of every value out of its range; what is absent is not looked at."""
    for name, (low, high) in ranges.items():
        value = values.get(name)
        if isinstance(value, int | float) and not low <= value <= high:
            yield name, f"{value:g} is not between {low:g} and {high:g}: {why}"


def rms(x: Numbers) -> float:
    """Root of the mean square; of vectors (n, 2), of their length."""
    return math.sqrt(float(np.mean(np.square(x))) * (x.shape[1] if x.ndim == 2 else 1))


def slow_part(x: NDArray[_Real], rate_hz: float) -> NDArray[_Real]:
    """Means over windows of 20 ms, which hold several periods of an injection; vectors (n, 2) to (m, 2)."""
    window = min(max(round(_SLOW_S * rate_hz), 1), len(x))
    windows = len(x) // window
    means: NDArray[_Real] = x[: windows * window].reshape(windows, window, 2).mean(axis=1)
    return means
