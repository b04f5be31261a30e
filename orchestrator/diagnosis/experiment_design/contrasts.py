"""The catalogue of contrasts: how each is recognised in a recording, and the stages that measure it. Fits nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from orchestrator.diagnosis.weak_form.segments import Piece, Prepared
from protocols import Contrast, SegmentStage


def holds(prepared: Prepared, contrast: Contrast) -> bool:
    """Whether a recording holds a contrast."""
    return _RECOGNISED[contrast](prepared)


def _of(prepared: Prepared, stage: SegmentStage) -> list[Piece]:
    return [p for p in prepared.pieces if p.stage is stage]


def _gates_off(prepared: Prepared) -> bool:
    return bool(_of(prepared, SegmentStage.GATES_OFF))


def _two_pwm_frequencies(prepared: Prepared) -> bool:
    return len({p.signals.pwm_frequency_hz for p in _of(prepared, SegmentStage.RESISTANCE)}) > 1


def _two_angles(prepared: Prepared) -> bool:
    return len({round(p.segment.rotor_angle_rad, 3) for p in prepared.pieces}) > 1


def _two_ripple_frequencies(prepared: Prepared) -> bool:
    ripples = _of(prepared, SegmentStage.INJECTION)
    return len({round(p.windows.period / p.signals.sampling_frequency_hz, 6) for p in ripples}) > 1


_RECOGNISED: Mapping[Contrast, Callable[[Prepared], bool]] = {
    Contrast.GATES_OFF: _gates_off,
    Contrast.SECOND_PWM_FREQUENCY: _two_pwm_frequencies,
    Contrast.SECOND_ANGLE: _two_angles,
    Contrast.SECOND_INJECTION_FREQUENCY: _two_ripple_frequencies,
}
