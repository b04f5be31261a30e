"""Which segment of a recording answers an excitation; reads settings, never waveforms."""

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
"""Relative difference of equal settings; of currents, over the rated one."""

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
    """Whether a segment holds what the excitation asks for, and enough of it.

    What the segment's settings leave out is taken to fit.

    Parameters
    ----------
    scale_a : float
        Currents may differ by a hundredth of this.
    """
    if KIND_OF.get(segment.stage) != excitation.kind:
        return False
    if segment.samples < excitation.rows(manifest.drive.sampling_frequency_hz):
        return False
    if abs(math.remainder(segment.rotor_angle_rad - excitation.rotor_angle_rad, math.tau)) > SETTING_TOLERANCE_RATIO:
        return False
    wanted, settings = excitation.model_dump(), segment.settings
    pwm_hz = settings.get("pwm_frequency_hz") or manifest.drive.pwm_frequency_hz
    if not _alike(excitation.pwm_frequency_hz or manifest.drive.pwm_frequency_hz, pwm_hz, 0.0):
        return False
    word = _WORDS[excitation.kind]
    if word is not None and settings.get(word, wanted[word]) != wanted[word]:
        return False
    return all(
        _alike(wanted[field], settings.get(field), scale_a if field.endswith("_a") else 0.0)
        for field in _FIELDS[excitation.kind]
        if not (field == "held_a" and wanted["swept_axis"] == "dq")
    )


def _alike(wanted: float | None, recorded: Any, scale: float) -> bool:
    if wanted is None or not isinstance(recorded, int | float):
        return True
    return abs(wanted - recorded) <= SETTING_TOLERANCE_RATIO * max(abs(wanted), abs(recorded), scale)


def in_words(excitation: Excitation) -> str:
    """The excitation in words, for errors."""
    fields = ", ".join(f"{field} {getattr(excitation, field):g}" for field in _FIELDS[excitation.kind])
    return f"{excitation.kind}" + (f" with {fields}" if fields else "")
