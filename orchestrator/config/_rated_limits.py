"""Limits that a motor file leaves out, from its nameplate.

The limits of an example motor do not suit another one. With I the rated current and V the rated voltage of a phase
(peak): currents up to 2.2 I, as a grid to 1.25 I on both axes needs with an injection's ripple; voltages up to V;
heat up to 3/2 R_s I^2 over the allowed duration, which the winding bears.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from orchestrator.validation.messages import KeyPath
from orchestrator.validation.strict_yaml import Document
from protocols import Positive, Strict

_MAX_CURRENT_RATIO = 2.2
"""Longest current vector over the rated one."""

RATED_FIELDS: dict[KeyPath, str] = {
    ("limits", "current_a"): "rated_current_rms_a",
    ("limits", "voltage_v"): "rated_voltage_rms_v",
}
"""The nameplate's field that a required limit follows from."""


class MotorLimits(Strict):
    """Limits in a motor file; those left out follow from the nameplate where the procedure's motor is an example."""

    current_a: Positive | None = None
    """Longest current vector [A peak]. Left out: 2.2 times the rated current's peak."""
    voltage_v: Positive | None = None
    """Longest voltage vector [V peak]. Left out: the rated voltage's peak in a phase."""
    energy_j: Positive | None = None
    """Most copper loss over the whole run [J]. Left out: that of the rated current for limits.duration_s."""
    duration_s: Positive | None = None
    """Longest run [s]. Left out: the procedure's."""


def add_rated_limits(document: Document, example: Mapping[str, Any]) -> list[str]:
    """Add the limits that are left out, where the nameplate has the values, and describe them in a sentence.

    Parameters
    ----------
    document : Document
        A procedure with a motor file laid over it; changed in place.
    example : mapping
        The limits of the procedure's example motor: its duration stays, and its energy where none can be derived.
    """
    motor, limits = document.data.get("motor"), document.data.get("limits")
    if not isinstance(motor, dict) or not isinstance(limits, dict):
        return []
    if "duration_s" in example:
        limits.setdefault("duration_s", example["duration_s"])
    current_rms = _positive(motor.get("rated_current_rms_a"))
    voltage_rms = _positive(motor.get("rated_voltage_rms_v"))
    resistance = _positive(motor.get("stator_resistance_ohm"))
    duration = _positive(limits.get("duration_s"))
    heat_j = 3.0 * resistance * current_rms * current_rms * duration
    current_a = _MAX_CURRENT_RATIO * math.sqrt(2.0) * current_rms
    derived = {
        "current_a": (current_a, f"A, {_MAX_CURRENT_RATIO:g} times the rated peak"),
        "voltage_v": (math.sqrt(2.0 / 3.0) * voltage_rms, "V, the rated phase peak"),
        "energy_j": (heat_j, f"J, the rated copper loss for {duration:g} s"),
    }
    added = []
    for name, (value, meaning) in derived.items():
        if name not in limits and 0.0 < value < math.inf:
            limits[name] = float(f"{value:.4g}")
            added.append(f"{name} {limits[name]:g} {meaning}")
    if "energy_j" in example:
        limits.setdefault("energy_j", example["energy_j"])
    return [f"limits, as the motor file has none of these: {'; '.join(added)}"] if added else []


def _positive(value: object) -> float:
    """A number above zero; 0 for anything else, which validation refuses later."""
    return float(value) if isinstance(value, int | float) and value > 0 else 0.0
