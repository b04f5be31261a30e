"""Which experiment tells two effects apart, as a stage that a procedure takes as it is; decides nothing else."""

from __future__ import annotations

import math
from typing import Any

from orchestrator.diagnosis._baseline import Start
from orchestrator.diagnosis._reports import NextExperiment
from protocols import SegmentStage

_RIPPLE = {"voltage_delay", "current_filter", "eddy_currents", "skin_effect"}
_PWM = {"dead_time", "device_drop"}
_CONSTANT = {"current_offset", "voltage_bias"}
_HEAT = {"winding_heating", "magnet_heating", "bus_sag"}
_FRAME = {"rotor_misalignment", "slot_harmonics", "brake_compliance"}


def next_experiment(start: Start, first: str, second: str) -> NextExperiment | None:
    """The experiment for a pair of effects; None where no stage of a procedure can part them."""
    pair = {first, second}
    stage, seconds = _stage(start, pair)
    if stage is None:
        return None
    return NextExperiment(stage=stage, separates=(first, second), minutes=round(seconds / 60.0, 2))


def _stage(start: Start, pair: set[str]) -> tuple[dict[str, Any] | None, float]:
    drive = start.prepared.manifest.drive
    a = round(start.current_a, 3)
    half = round(0.5 * a, 3)
    f, volts = _injection(start)
    if pair <= _CONSTANT:
        return {"kind": "gates_off", "duration_s": 2.0}, 3.0
    if pair & _PWM:
        pwm = drive.pwm_frequency_hz or drive.sampling_frequency_hz
        small = [round(x * a, 3) for x in (0.02, 0.05, 0.15)]
        points = [[s * x, 0.0] for x in (*small, a) for s in (1.0, -1.0)]
        return {"kind": "resistance", "points_a": points, "pwm_frequencies_hz": [pwm, 2.0 * pwm]}, 2.0 * len(points)
    if pair & {"hysteresis"}:
        stage: dict[str, Any] = {"kind": "injection", "points_a": [[0.0, 0.0], [half, 0.0], [0.0, half], [-half, 0.0]]}
        return {**stage, "amplitudes_v": [volts, 0.5 * volts, 0.25 * volts]}, 30.0
    if len(pair & _RIPPLE) >= 1:
        stage = {"kind": "injection", "points_a": [[0.0, 0.0], [half, 0.0], [0.0, half]], "frequency_hz": 0.5 * f}
        return {**stage, "amplitudes_v": [0.5 * volts]}, 8.0
    if pair & _HEAT:
        return {"kind": "resistance", "points_a": [[a, 0.0]], "anchor": True, "duration_s": 5.0}, 0.2
    if pair & _FRAME:
        return {"kind": "classical", "axes": ["d", "q"], "held_a": [0.0, half, -half], "periods": 2}, 24.0
    points = [[a * math.cos(k * math.pi / 6.0), a * math.sin(k * math.pi / 6.0)] for k in range(12)]
    return {"kind": "resistance", "points_a": [[round(x, 3), round(y, 3)] for x, y in points]}, 15.0


def _injection(start: Start) -> tuple[float, float]:
    """Frequency and amplitude of the injection there was, else of a likely one."""
    for piece in start.prepared.pieces:
        settings = piece.segment.settings
        if piece.stage is SegmentStage.INJECTION and settings.get("frequency_hz") and settings.get("amplitude_v"):
            return float(settings["frequency_hz"]), float(settings["amplitude_v"])
    f = start.prepared.manifest.drive.sampling_frequency_hz / 20.0
    return f, round(4.0 * f * 0.2 * start.l_d_h * start.current_a, 1)
