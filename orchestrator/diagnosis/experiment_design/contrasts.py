"""The catalogue of contrasts: how each is recognised in a recording, and the stages that measure it. Fits nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.diagnosis.criteria import DesignCriteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentSignals
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from orchestrator.stages import injection_voltage_v
from protocols import Contrast, SegmentStage

Stage = dict[str, Any]
"""Of a procedure, as it is written there."""


@dataclass(frozen=True)
class Bench:
    """What stages are scaled from: the machine, the drive, and the injection that a recording shows.

    Attributes
    ----------
    current_a : float
        Peak.
    pwm_hz, sampling_hz : float
    injection_hz, injection_v : float
        Of the injection there was, else of a likely one.
    design : DesignCriteria
    """

    current_a: float
    pwm_hz: float
    sampling_hz: float
    injection_hz: float
    injection_v: float
    design: DesignCriteria

    @classmethod
    def of(cls, setup: DiagnosisSetup) -> Bench:
        """Of a recording."""
        prepared, design = setup.prepared, setup.prepared.criteria.design
        fs = prepared.manifest.drive.sampling_frequency_hz
        frequency = fs / design.samples_per_period
        volts = injection_voltage_v(setup.current_a, setup.l_d_h, frequency)
        for piece in _of(prepared, SegmentStage.INJECTION):
            settings = piece.segment.settings
            if settings.get("frequency_hz") and settings.get("amplitude_v"):
                frequency, volts = float(settings["frequency_hz"]), float(settings["amplitude_v"])
                break
        pwm = prepared.manifest.drive.pwm_frequency_hz or fs
        return cls(setup.current_a, pwm, fs, frequency, volts, design)

    def holds(self, points: Iterable[tuple[float, float]], **more: Any) -> Stage:
        """Direct currents held at points in parts of the current."""
        asked = {"kind": "resistance", "points_a": self._points(points)}
        return {**asked, "settle_s": self.design.settle_s, "duration_s": self.design.hold_s, **more}

    def injections(self, points: Iterable[tuple[float, float]], frequency: float, *amplitudes: float) -> Stage:
        """Ripple at points, a frequency and amplitudes in parts of the current and of the injection there was."""
        return {
            "kind": "injection",
            "points_a": self._points(points),
            "amplitudes_v": [tidy(amplitude * self.injection_v) for amplitude in amplitudes],
            "frequency_hz": frequency * self.injection_hz,
            "settle_s": self.design.settle_s,
            "duration_s": self.design.injection_s,
        }

    def _points(self, points: Iterable[tuple[float, float]]) -> list[list[float]]:
        return [[tidy(d * self.current_a), tidy(q * self.current_a)] for d, q in points]


@dataclass(frozen=True)
class Declared:
    """One contrast.

    Attributes
    ----------
    text : str
        What was measured where a recording holds it.
    holds : callable
        Whether a recording holds it.
    stages : callable
        Stages that measure it, each by itself; none where an operator has to do more than a stage can ask for.
    """

    text: str
    holds: Callable[[PreparedRecording], bool]
    stages: Callable[[Bench], list[Stage]]


def holds(prepared: PreparedRecording, contrast: Contrast) -> bool:
    """Whether a recording holds a contrast."""
    return CONTRASTS[contrast].holds(prepared)


def minutes(stage: Stage) -> float:
    """How long a stage of the catalogue takes."""
    points = len(stage.get("points_a", [0]))
    repeated = len(stage.get("amplitudes_v", [0])) * len(stage.get("pwm_frequencies_hz", [0]))
    return float(points * repeated * (stage["duration_s"] + stage.get("settle_s", 0.0)) / 60.0)


def tidy(value: float) -> float:
    """Three digits, and no negative zero: a person reads these."""
    return float(f"{value:.3g}") + 0.0 if abs(value) > 1e-9 else 0.0


def _of(prepared: PreparedRecording, stage: SegmentStage) -> list[SegmentSignals]:
    return [p for p in prepared.pieces if p.stage is stage]


def _currents(prepared: PreparedRecording, stage: SegmentStage) -> Array:
    """Mean currents of a stage's segments in dq, in parts of the largest current; shape (segments, 2)."""
    means = [to_dq(p.signals.i_ab, p.segment.rotor_angle_rad).mean(axis=0) for p in _of(prepared, stage)]
    low, high, q = prepared.current_range
    return np.reshape(means, (-1, 2)) / max(-low, high, q)


def _gates_off(prepared: PreparedRecording) -> bool:
    return bool(_of(prepared, SegmentStage.GATES_OFF))


def _small_currents(prepared: PreparedRecording) -> bool:
    shares = prepared.criteria.design.small_currents
    sizes = np.hypot(*_currents(prepared, SegmentStage.RESISTANCE).T)
    return int(np.sum(sizes < 1.5 * max(shares))) >= len(shares)


def _small_holds(bench: Bench) -> list[Stage]:
    return [bench.holds((side * share, 0.0) for share in bench.design.small_currents for side in (1, -1))]


def _two_pwm_frequencies(prepared: PreparedRecording) -> bool:
    return len({p.signals.pwm_frequency_hz for p in _of(prepared, SegmentStage.RESISTANCE)}) > 1


def _pwm_holds(bench: Bench) -> list[Stage]:
    points = [(side * share, 0.0) for share in bench.design.pwm_currents for side in (1, -1)]
    return [bench.holds(points, pwm_frequencies_hz=[bench.pwm_hz, 2.0 * bench.pwm_hz])]


def _all_around(prepared: PreparedRecording) -> bool:
    d, q = _currents(prepared, SegmentStage.RESISTANCE).T
    step = 2.0 * math.pi / prepared.criteria.design.directions
    held = {round(float(angle / step)) for angle in np.arctan2(q, d)[np.hypot(d, q) > 0.5]}
    return len(held) > prepared.criteria.design.directions / 2


def _ring(bench: Bench) -> list[Stage]:
    count = bench.design.directions
    angles = (2.0 * math.pi * k / count for k in range(count))
    return [bench.holds((math.cos(angle), math.sin(angle)) for angle in angles)]


def _seconds(piece: SegmentSignals) -> float:
    return len(piece.signals.v_dc) / piece.signals.sampling_frequency_hz


def _measured_again(prepared: PreparedRecording) -> bool:
    end = prepared.pieces[-1].signals.start_s
    for stage in (SegmentStage.RESISTANCE, SegmentStage.INJECTION):
        pieces, currents = _of(prepared, stage), _currents(prepared, stage)
        for k, piece in enumerate(pieces):
            later = [p.signals.start_s - piece.signals.start_s > 0.5 * end for p in pieces]
            if np.any(np.hypot(*(currents - currents[k]).T)[later] < prepared.criteria.selection.same_current):
                return True
    return False


def _long_hold(prepared: PreparedRecording) -> bool:
    pieces, currents = _of(prepared, SegmentStage.RESISTANCE), _currents(prepared, SegmentStage.RESISTANCE)
    longest = prepared.criteria.design.long_hold_s
    return any(_seconds(p) > 0.5 * longest and np.hypot(*i) > 0.5 for p, i in zip(pieces, currents, strict=True))


def _two_amplitudes(prepared: PreparedRecording) -> bool:
    swings = [float(np.linalg.norm(np.std(p.signals.v_ab, axis=0))) for p in _of(prepared, SegmentStage.INJECTION)]
    return bool(swings) and max(swings) > prepared.criteria.selection.amplitudes_apart * min(swings)


def _two_ripple_frequencies(prepared: PreparedRecording) -> bool:
    ripples = _of(prepared, SegmentStage.INJECTION)
    return len({round(p.windows.period / p.signals.sampling_frequency_hz, 6) for p in ripples}) > 1


def _other_frequencies(bench: Bench) -> list[Stage]:
    # Twice the frequency asks for twice the voltage to swing the flux as far, and for samples to see its edges.
    few, faster = bench.design.few_points, 8.0 * bench.injection_hz <= bench.sampling_hz
    return [bench.injections(few, 0.5, 0.5), *([bench.injections(few, 2.0, 1.0)] if faster else [])]


def _along_both_axes(prepared: PreparedRecording) -> bool:
    currents = _currents(prepared, SegmentStage.INJECTION)
    return len(currents) > 0 and bool((np.ptp(currents, axis=0) > 0.5).all())


def _two_angles(prepared: PreparedRecording) -> bool:
    return len({round(p.segment.rotor_angle_rad, 3) for p in prepared.pieces}) > 1


CONTRASTS: Mapping[Contrast, Declared] = {
    Contrast.GATES_OFF: Declared(
        "a reading with all gates off",
        _gates_off,
        lambda bench: [{"kind": "gates_off", "duration_s": bench.design.gates_off_s}],
    ),
    Contrast.SMALL_CURRENTS: Declared("direct currents close to zero", _small_currents, _small_holds),
    Contrast.SECOND_PWM_FREQUENCY: Declared(
        "direct currents at a second PWM frequency", _two_pwm_frequencies, _pwm_holds
    ),
    Contrast.DIRECTIONS: Declared("direct currents all around", _all_around, _ring),
    Contrast.ANCHOR: Declared(
        "one point once more at the end",
        _measured_again,
        lambda bench: [bench.holds([(1.0, 0.0)], duration_s=bench.design.anchor_s, anchor=True)],
    ),
    Contrast.LONG_HOLD: Declared(
        "a direct current for long",
        _long_hold,
        lambda bench: [bench.holds([(1.0, 0.0)], duration_s=bench.design.long_hold_s)],
    ),
    Contrast.SECOND_INJECTION_AMPLITUDE: Declared(
        "ripple of a second amplitude",
        _two_amplitudes,
        lambda bench: [bench.injections(bench.design.few_points, 1.0, 0.5, 0.25)],
    ),
    Contrast.SECOND_INJECTION_FREQUENCY: Declared(
        "ripple of a second frequency", _two_ripple_frequencies, _other_frequencies
    ),
    Contrast.OPERATING_POINTS: Declared(
        "ripple along both axes", _along_both_axes, lambda bench: [bench.injections(bench.design.axis_points, 1.0, 1.0)]
    ),
    Contrast.SECOND_ANGLE: Declared("the rotor locked at a second angle", _two_angles, lambda bench: []),
}
"""Every contrast, those that take little time first."""
