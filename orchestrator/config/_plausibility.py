"""What no motor has and no test bench does: numbers that are slips of a unit or of the keyboard. Knows no limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from protocols import Procedure

_MOTOR = {
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
_DRIVE = {"sampling_frequency_hz": (100.0, 1e6), "pwm_frequency_hz": (100.0, 1e6)}
"""Options that mean the same in every drive that has them."""
_LONGEST_SETTING_S = 86_400.0
"""A day: for one setting of one stage."""

Path = tuple[str | int, ...]


def implausible(procedure: Procedure) -> Iterator[tuple[Path, str]]:
    """Key path and problem of every number that cannot be meant."""
    yield from _outside(("motor",), procedure.motor.model_dump(), _MOTOR, "no motor has that")
    yield from _outside(("drive",), procedure.drive.options, _DRIVE, "no drive does that")
    for index, stage in enumerate(procedure.stages):
        for name, value in stage:
            if name.endswith("_s") and isinstance(value, float) and value > _LONGEST_SETTING_S:
                yield ("stages", index, name), f"{value:g} s is more than a day"


def _outside(
    path: Path, values: Mapping[str, Any], ranges: Mapping[str, tuple[float, float]], why: str
) -> Iterator[tuple[Path, str]]:
    for name, (low, high) in ranges.items():
        value = values.get(name)
        if isinstance(value, int | float) and not low <= value <= high:
            yield (*path, name), f"{value:g} is not between {low:g} and {high:g}: {why}"
