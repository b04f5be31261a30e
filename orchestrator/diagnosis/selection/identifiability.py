"""Which look-alikes a recording can tell apart by what was measured, and what it lacks for the others. Fits nothing."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.diagnosis.weak_form.segments import Prepared
from protocols import Effect, SegmentStage


def _two_pwm_frequencies(prepared: Prepared) -> bool:
    return len({p.signals.pwm_frequency_hz for p in prepared.pieces if p.stage is SegmentStage.RESISTANCE}) > 1


def _gates_off(prepared: Prepared) -> bool:
    return any(p.stage is SegmentStage.GATES_OFF for p in prepared.pieces)


def _two_angles(prepared: Prepared) -> bool:
    return len({round(p.segment.rotor_angle_rad, 3) for p in prepared.pieces}) > 1


def _two_ripple_frequencies(prepared: Prepared) -> bool:
    """A lag of the current's sensors falls with frequency where it is long; a delay of the voltage does not."""
    ripples = [p for p in prepared.pieces if p.stage is SegmentStage.INJECTION]
    return len({round(p.windows.period / p.signals.sampling_frequency_hz, 6) for p in ripples}) > 1


_ASKED: dict[frozenset[str], Callable[[Prepared], bool]] = {
    frozenset({"dead_time", "device_drop"}): _two_pwm_frequencies,
    frozenset({"current_offset", "voltage_bias"}): _gates_off,
    frozenset({"rotor_misalignment", "slot_harmonics"}): _two_angles,
    frozenset({"voltage_delay", "current_filter"}): _two_ripple_frequencies,
}


def separable(prepared: Prepared, first: Effect, second: Effect) -> bool:
    """Whether the recording has what parts two effects; declared twins without a condition here are not parted."""
    pair = frozenset({first.name, second.name})
    if pair in _ASKED:
        return _ASKED[pair](prepared)
    return second.name not in first.twins and first.name not in second.twins
