"""Matches segments of a recording to excitations by their settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from protocols import Excitation, ExcitationKind, Manifest, Segment, SegmentStage

KIND_OF: Mapping[SegmentStage, ExcitationKind] = {
    SegmentStage.GATES_OFF: "gates_off",
    SegmentStage.ALIGNMENT: "hold",
    SegmentStage.RESISTANCE: "hold",
    SegmentStage.CLASSICAL: "trapezoid",
    SegmentStage.LOCK_CHECK: "injection",
    SegmentStage.INJECTION: "injection",
}
SETTING_TOLERANCE_RATIO = 0.01
"""Largest relative difference of equal settings (of currents: over the rated one)."""

_FIELDS: Mapping[ExcitationKind, tuple[str, ...]] = {
    "gates_off": (),
    "hold": ("current_d_a", "current_q_a"),
    "trapezoid": ("held_a", "amplitude_a", "period_s"),
    "injection": ("target_d_a", "target_q_a", "amplitude_v", "frequency_hz", "rotation_hz"),
}
_WORDS: Mapping[ExcitationKind, str | None] = {
    "gates_off": None,
    "hold": None,
    "trapezoid": "swept_axis",
    "injection": "waveform",
}


def answers(segment: Segment, excitation: Excitation, manifest: Manifest, scale_a: float) -> bool:
    """Whether a segment matches an excitation and is long enough.

    Settings that the segment does not state are assumed to match.

    Parameters
    ----------
    scale_a : float
        Scale of the currents' tolerance [A].
    """
    if KIND_OF.get(segment.stage) != excitation.kind:
        return False
    if segment.samples < excitation.rows(manifest.drive.sampling_frequency_hz):
        return False
    if abs(math.remainder(segment.rotor_angle_rad - excitation.rotor_angle_rad, math.tau)) > SETTING_TOLERANCE_RATIO:
        return False
    requested, settings = excitation.model_dump(), segment.settings
    pwm_hz = settings.get("pwm_frequency_hz") or manifest.drive.pwm_frequency_hz
    if not _matches(excitation.pwm_frequency_hz or manifest.drive.pwm_frequency_hz, pwm_hz, 0.0):
        return False
    word = _WORDS[excitation.kind]
    if word is not None and settings.get(word, requested[word]) != requested[word]:
        return False
    return all(
        _matches(requested[field], settings.get(field), scale_a if field.endswith("_a") else 0.0)
        for field in _FIELDS[excitation.kind]
        if not (field == "held_a" and requested["swept_axis"] == "dq")
    )


def _matches(requested: float | None, recorded: Any, scale: float) -> bool:
    if requested is None or not isinstance(recorded, int | float):
        return True
    return abs(requested - recorded) <= SETTING_TOLERANCE_RATIO * max(abs(requested), abs(recorded), scale)


def describe(excitation: Excitation) -> str:
    """Description of the excitation, for errors."""
    fields = ", ".join(f"{field} {getattr(excitation, field):g}" for field in _FIELDS[excitation.kind])
    return f"{excitation.kind}" + (f" with {fields}" if fields else "")
