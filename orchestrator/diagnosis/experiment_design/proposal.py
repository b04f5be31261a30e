"""Which experiment tells two effects apart, as a stage that a procedure takes as it is; measures nothing.

Every stage of a small catalogue is judged by what the fitted model predicts that it would separate, in chi2 a minute.
Where nothing can be predicted, a table of what is known to separate which effects has the word.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from orchestrator.diagnosis.experiment_design.separation import rivals, separation
from orchestrator.diagnosis.fitting.baseline import Start
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.fitting.model import Fit
from protocols import NextExperiment, SegmentStage

_RIPPLE = {"voltage_delay", "current_filter", "eddy_currents", "skin_effect"}
_PWM = {"dead_time", "device_drop"}
_CONSTANT = {"current_offset", "voltage_bias"}
_HEAT = {"winding_heating", "magnet_heating", "bus_sag"}
_FRAME = {"rotor_misalignment", "slot_harmonics", "brake_compliance"}

_HOLD_S, _SETTLE_S, _TURNS_S = 0.5, 0.5, 1.0
_LEAST = 25.0
"""chi2 that an experiment has to be predicted to separate before it is worth an operator's time: five sigma."""

Stage = dict[str, Any]


def next_experiment(
    start: Start, first: str, second: str, fit: Fit | None = None, library: Sequence[Candidate] = ()
) -> NextExperiment | None:
    """The experiment for a pair of effects; None where no stage of a procedure can part them.

    Parameters
    ----------
    start : Start
    first, second : str
        Names of the effects.
    fit : Fit, optional
        The model with the first effect in it; without it nothing is predicted.
    library : sequence of Candidate
        Holds the second.
    """
    stage = _predicted(start, first, second, fit, library)
    if stage is None:
        stage = _by_table(start, {first, second})
    if stage is None:
        return None
    return NextExperiment(stage=stage, separates=(first, second), minutes=round(_minutes(stage), 2))


def _predicted(start: Start, first: str, second: str, fit: Fit | None, library: Sequence[Candidate]) -> Stage | None:
    """The stage of most separation a minute; None where none is predicted to be worth it."""
    candidate = next((c for c in library if c.name == second), None)
    if fit is None or candidate is None:
        return None
    pair = rivals(start, fit, first, candidate)
    if pair is None:
        return None
    gains = [(separation(start, pair, stage), stage) for stage in catalogue(start)]
    worth = [(gain / _minutes(stage), stage) for gain, stage in gains if math.isfinite(gain) and gain > _LEAST]
    return max(worth, key=lambda item: item[0])[1] if worth else None


def catalogue(start: Start) -> list[Stage]:
    """What can be measured on any drive that has measured the recording, cheap stages first."""
    drive = start.prepared.manifest.drive
    pwm = drive.pwm_frequency_hz or drive.sampling_frequency_hz
    a = _tidy(start.current_a)
    f, volts = _injection(start)
    ring = [[_tidy(a * math.cos(k * math.pi / 6)), _tidy(a * math.sin(k * math.pi / 6))] for k in range(12)]
    dense = [[_tidy(s * x * a), 0.0] for x in (0.01, 0.02, 0.05, 0.1, 0.2) for s in (1, -1)]
    spread = [[_tidy(s * x * a), 0.0] for x in (0.02, 0.05, 0.15, 1.0) for s in (1, -1)]
    few = [[0.0, 0.0], [_tidy(0.5 * a), 0.0], [0.0, _tidy(0.5 * a)], [_tidy(-0.5 * a), 0.0]]
    on_axes = [[x, 0.0] for x in (_tidy(-a), _tidy(-0.5 * a), _tidy(0.5 * a))] + [[0.0, _tidy(0.5 * a)], [0.0, a]]
    return [
        {"kind": "gates_off", "duration_s": 2.0},
        _holds(dense),
        _holds(spread, pwm_frequencies_hz=[pwm, 2.0 * pwm]),
        _holds(ring),
        {**_holds([[a, 0.0]]), "duration_s": 5.0, "anchor": True},
        _injections(few, f, [_tidy(0.5 * volts), _tidy(0.25 * volts)]),
        _injections(few, 0.5 * f, [_tidy(0.5 * volts)]),
        *([_injections(few, 2.0 * f, [volts])] if 8.0 * f <= drive.sampling_frequency_hz else []),
        _injections(on_axes, f, [volts]),
    ]


def _holds(points: list[list[float]], **more: Any) -> Stage:
    return {"kind": "resistance", "points_a": points, "settle_s": _SETTLE_S, "duration_s": _HOLD_S, **more}


def _injections(points: list[list[float]], frequency_hz: float, amplitudes_v: list[float]) -> Stage:
    asked = {"points_a": points, "amplitudes_v": amplitudes_v, "frequency_hz": frequency_hz}
    return {"kind": "injection", **asked, "settle_s": _SETTLE_S, "duration_s": _TURNS_S}


def _minutes(stage: Stage) -> float:
    """What a stage takes, where it says so itself; else what its settings usually come to."""
    if stage["kind"] == "classical":
        lines = sum(1 if axis == "dq" else len(stage["held_a"]) for axis in stage["axes"])
        return float(lines * 2.0 * stage["periods"] / 60.0)
    points = len(stage.get("points_a", [0]))
    repeated = len(stage.get("amplitudes_v", [0])) * len(stage.get("pwm_frequencies_hz", [0]))
    return float(points * repeated * (stage["duration_s"] + stage.get("settle_s", 0.0)) / 60.0)


def _by_table(start: Start, pair: set[str]) -> Stage | None:
    drive = start.prepared.manifest.drive
    a = _tidy(start.current_a)
    half = _tidy(0.5 * a)
    f, volts = _injection(start)
    if pair <= _CONSTANT:
        return {"kind": "gates_off", "duration_s": 2.0}
    if pair & _PWM:
        pwm = drive.pwm_frequency_hz or drive.sampling_frequency_hz
        points = [[_tidy(s * x * a), 0.0] for x in (0.02, 0.05, 0.15, 1.0) for s in (1, -1)]
        return _holds(points, pwm_frequencies_hz=[pwm, 2.0 * pwm])
    if "hysteresis" in pair:
        points = [[0.0, 0.0], [half, 0.0], [0.0, half], [-half, 0.0]]
        return _injections(points, f, [volts, _tidy(0.5 * volts), _tidy(0.25 * volts)])
    if pair & _RIPPLE:
        return _injections([[0.0, 0.0], [half, 0.0], [0.0, half]], 0.5 * f, [_tidy(0.5 * volts)])
    if pair & _HEAT:
        return {**_holds([[a, 0.0]]), "duration_s": 5.0, "anchor": True}
    if pair & _FRAME:
        return {"kind": "classical", "axes": ["d", "q"], "held_a": [0.0, half, -half], "periods": 2}
    ring = [[a * math.cos(k * math.pi / 6), a * math.sin(k * math.pi / 6)] for k in range(12)]
    return _holds([[_tidy(x), _tidy(y)] for x, y in ring])


def _injection(start: Start) -> tuple[float, float]:
    """Frequency and amplitude of the injection there was, else of a likely one."""
    for piece in start.prepared.pieces:
        settings = piece.segment.settings
        if piece.stage is SegmentStage.INJECTION and settings.get("frequency_hz") and settings.get("amplitude_v"):
            return float(settings["frequency_hz"]), float(settings["amplitude_v"])
    f = start.prepared.manifest.drive.sampling_frequency_hz / 20.0
    return f, _tidy(4.0 * f * 0.2 * start.l_d_h * start.current_a)


def _tidy(value: float) -> float:
    """Three digits, and no negative zero: a person reads these."""
    return float(f"{value:.3g}") + 0.0 if abs(value) > 1e-9 else 0.0
