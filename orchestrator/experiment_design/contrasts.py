"""The catalogue of stages: for each contrast, those that measure it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.selection.contrasts import DIRECTIONS, LONG_HOLD_S, SMALL_CURRENTS
from orchestrator.experiment_design.criteria import DesignCriteria
from orchestrator.stages import injection_voltage_v
from protocols import Contrast, SegmentStage

SETTLE_S: float = 0.5
"""Settling before each point of a stage [s]: dozens of L/R."""
HOLD_S: float = 0.5
"""Length of each held current [s]: its mean is known to a hundredth of a reading's noise."""
INJECTION_S: float = 1.0
"""Injection at each point [s]: one turn of the injected direction."""
GATES_OFF_S: float = 2.0
"""Length of a reading with all gates off [s]."""
ANCHOR_S: float = 5.0
"""Length of a repeated point [s]."""
PWM_CURRENTS: tuple[float, ...] = (0.02, 0.05, 0.15, 1.0)
"""Parts of the current that are held at two PWM frequencies: within the knee of an inverter's error, and beyond
it."""
FEW_POINTS: tuple[tuple[float, float], ...] = ((0, 0), (0.5, 0), (0, 0.5), (-0.5, 0))
"""Points, in parts of the current, with a ripple of another amplitude or frequency: zero, and off it."""
AXIS_POINTS: tuple[tuple[float, float], ...] = ((-1, 0), (-0.5, 0), (0.5, 0), (0, 0.5), (0, 1))
"""Points, in parts of the current, that show the ripple along both axes."""
SAMPLES_PER_PERIOD: float = 20.0
"""Samples in a period of an injected wave, where the recording has no injection."""

Stage = dict[str, Any]
"""A stage in a procedure's form."""


@dataclass(frozen=True)
class Bench:
    """The quantities that stages are scaled from: of the machine, the drive, and a recording's injection.

    Attributes
    ----------
    current_a : float
        Peak.
    pwm_hz, sampling_hz : float
    injection_hz, injection_v : float
        Of the recording's injection, else of a usual one.
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
        """The bench of a recording."""
        prepared, design = setup.prepared, setup.prepared.criteria.design
        fs = prepared.manifest.drive.sampling_frequency_hz
        frequency = fs / SAMPLES_PER_PERIOD
        volts = injection_voltage_v(setup.current_a, setup.l_d_h, frequency)
        for piece in (p for p in prepared.pieces if p.stage is SegmentStage.INJECTION):
            settings = piece.segment.settings
            if settings.get("frequency_hz") and settings.get("amplitude_v"):
                frequency, volts = float(settings["frequency_hz"]), float(settings["amplitude_v"])
                break
        pwm = prepared.manifest.drive.pwm_frequency_hz or fs
        return cls(setup.current_a, pwm, fs, frequency, volts, design)

    def holds(self, points: Iterable[tuple[float, float]], **more: Any) -> Stage:
        """A stage of direct currents held at points in parts of the current."""
        stage = {"kind": "resistance", "points_a": self._points(points)}
        return {**stage, "settle_s": SETTLE_S, "duration_s": HOLD_S, **more}

    def injections(self, points: Iterable[tuple[float, float]], frequency: float, *amplitudes: float) -> Stage:
        """A stage of injections at points in parts of the current, relative to the bench's frequency and amplitude."""
        return {
            "kind": "injection",
            "points_a": self._points(points),
            "amplitudes_v": [round_for_people(amplitude * self.injection_v) for amplitude in amplitudes],
            "frequency_hz": frequency * self.injection_hz,
            "settle_s": SETTLE_S,
            "duration_s": INJECTION_S,
        }

    def _points(self, points: Iterable[tuple[float, float]]) -> list[list[float]]:
        return [[round_for_people(d * self.current_a), round_for_people(q * self.current_a)] for d, q in points]


def minutes(stage: Stage) -> float:
    """Duration of a stage of the catalogue [min]."""
    points = len(stage.get("points_a", [0]))
    repeated = len(stage.get("amplitudes_v", [0])) * len(stage.get("pwm_frequencies_hz", [0]))
    return float(points * repeated * (stage["duration_s"] + stage.get("settle_s", 0.0)) / 60.0)


def round_for_people(value: float) -> float:
    """The value with three digits, and without a negative zero."""
    return float(f"{value:.3g}") + 0.0 if abs(value) > 1e-9 else 0.0


def _both_signs(shares: Iterable[float]) -> list[tuple[float, float]]:
    return [(side * share, 0.0) for share in shares for side in (1, -1)]


def _other_frequencies(bench: Bench) -> list[Stage]:
    # Twice the frequency takes twice the voltage for the same swing of the flux, and enough samples for its edges.
    few, faster = FEW_POINTS, 8.0 * bench.injection_hz <= bench.sampling_hz
    return [bench.injections(few, 0.5, 0.5), *([bench.injections(few, 2.0, 1.0)] if faster else [])]


STAGES: Mapping[Contrast, Callable[[Bench], list[Stage]]] = {
    Contrast.GATES_OFF: lambda bench: [{"kind": "gates_off", "duration_s": GATES_OFF_S}],
    Contrast.SMALL_CURRENTS: lambda bench: [bench.holds(_both_signs(SMALL_CURRENTS))],
    Contrast.SECOND_PWM_FREQUENCY: lambda bench: [
        bench.holds(_both_signs(PWM_CURRENTS), pwm_frequencies_hz=[bench.pwm_hz, 2.0 * bench.pwm_hz])
    ],
    Contrast.DIRECTIONS: lambda bench: [
        bench.holds((math.cos(angle), math.sin(angle)) for angle in 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    ],
    Contrast.ANCHOR: lambda bench: [bench.holds([(1.0, 0.0)], duration_s=ANCHOR_S, anchor=True)],
    Contrast.LONG_HOLD: lambda bench: [bench.holds([(1.0, 0.0)], duration_s=LONG_HOLD_S)],
    Contrast.SECOND_INJECTION_AMPLITUDE: lambda bench: [bench.injections(FEW_POINTS, 1.0, 0.5, 0.25)],
    Contrast.SECOND_INJECTION_FREQUENCY: _other_frequencies,
    Contrast.OPERATING_POINTS: lambda bench: [bench.injections(AXIS_POINTS, 1.0, 1.0)],
    Contrast.SECOND_ANGLE: lambda bench: [],
}
"""Stages that measure each contrast, each by itself, short ones first; none where an operator has to act in a way that
no stage can request."""
