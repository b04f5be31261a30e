"""Explanations of an overcurrent: noise, ripple, the nameplate's inductance, or what nothing measured explains."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from orchestrator.config import PlannedPoint
from orchestrator.engine._overcurrent import RippleRatio, SensorNoise, explain_overcurrent
from protocols import CurrentControl, Hold, Injection, Limits, Motor, SegmentStage
from tests.support.tiny import MOTOR, STAGES, run_tiny

CONTROL = CurrentControl(bandwidth_hz=25.0)
LIMITS = Limits(current_a=5.0, voltage_v=150.0)
QUIET = SensorNoise(offset_a=0.0, max_std_a=0.003, mean_square_a2=2e-5)
NOISY = SensorNoise(offset_a=0.02, max_std_a=0.4, mean_square_a2=0.2)


def hold(current_a: float) -> PlannedPoint:
    excitation = Hold(current_d_a=current_a, current_q_a=0.0, settle_s=1.0, duration_s=0.5, control=CONTROL)
    return PlannedPoint("alignment-000", 2, SegmentStage.ALIGNMENT, excitation, {})


def injection(current_a: float, amplitude_v: float) -> PlannedPoint:
    fields = {"settle_s": 0.2, "duration_s": 0.2, "frequency_hz": 500.0, "rotation_hz": 4.0, "control": CONTROL}
    excitation = Injection(target_d_a=current_a, target_q_a=0.0, amplitude_v=amplitude_v, **fields)
    return PlannedPoint("injection-000", 8, SegmentStage.INJECTION, excitation, {})


def explain(point: PlannedPoint, noise: SensorNoise | None = QUIET, seen: RippleRatio | None = None) -> str:
    return explain_overcurrent(point, Motor(**MOTOR), LIMITS, 10_000.0, noise, seen)


def test_the_noise_is_named_with_a_current_that_leaves_room_for_it() -> None:
    hint = explain(hold(4.0), NOISY)
    assert "the noise reaches the trip" in hint
    # 0.4 A sqrt(2 ln 15000) + 0.02 A = 1.77 A of 5 A
    assert "currents of 3.2 A at most in stages.2" in hint
    assert "limits.current_a of 5.8 A" in hint


def test_peak_noise_is_reached_once_in_so_many_rows() -> None:
    readings = np.random.default_rng(1).normal(scale=0.4, size=(200, 15_000, 2))
    peaks = np.linalg.norm(readings, axis=2).max(axis=1)
    assert np.median(peaks) == pytest.approx(NOISY.peak_a(15_000), rel=0.05)


def test_noise_beyond_the_limit_asks_for_other_sensors() -> None:
    hint = explain(hold(4.0), SensorNoise(offset_a=0.0, max_std_a=1.1, mean_square_a2=2.0))
    assert "quieter sensors" in hint
    assert "at most" not in hint


def test_a_ripple_many_times_the_nameplates_is_a_wrong_inductance() -> None:
    hint = explain(injection(3.0, 40.0), seen=RippleRatio("lock_check-000", 10.0))
    assert "10 times the nameplate's" in hint
    assert "d_inductance_h 0.0043 and q_inductance_h 0.0069" in hint


def test_a_ripple_that_the_plan_knew_is_weakened() -> None:
    hint = explain(injection(4.0, 200.0))
    assert "the ripple reaches the trip" in hint
    assert "an injection of 85 V ends that" in hint


def test_a_controlled_current_that_nothing_explains_is_an_overshoot_or_a_short() -> None:
    hint = explain(hold(3.0))
    assert "overshoot" in hint
    assert "control.bandwidth_hz of 12.5" in hint
    assert "expect 8.5 ohm" in hint


def test_an_injection_that_nothing_explains_is_an_inductance_or_a_short() -> None:
    hint = explain(injection(3.0, 40.0), noise=None)
    assert "inductance below the nameplate's by 2.2 times" in hint
    assert "short" in hint


@pytest.mark.parametrize(
    ("noise_a", "hint"),
    [(0.5, "the noise reaches the trip"), (1.0, "offset, noise or scale of the sensors reach the trip")],
    ids=["in a stage", "with the gates off"],
)
def test_a_run_that_trips_on_noise_says_so(tmp_path: Path, noise_a: float, hint: str) -> None:
    result = run_tiny(tmp_path, stages=STAGES[:5], drive={"plant": {"sensors": {"noise_a": noise_a}}})
    assert result.outcome.ending == "faulted"
    assert hint in result.outcome.reason, result.outcome.reason


def test_a_nameplate_inductance_ten_times_too_large_is_reported_with_the_right_one(tmp_path: Path) -> None:
    lock = {"torque_current_a": 3.4, "amplitude_v": 100.0, "frequency_hz": 312.5, "settle_s": 0.2, "duration_s": 0.2}
    result = run_tiny(
        tmp_path,
        stages=[STAGES[0], STAGES[3], {"kind": "lock_check", **lock}],
        motor={**MOTOR, "d_inductance_h": 0.4325, "q_inductance_h": 0.4325},
        drive={"plant": {"magnetics": {"kind": "polynomial", "d_inductance_h": 0.04325, "q_inductance_h": 0.04325}}},
        limits={"current_a": 4.0, "voltage_v": 150.0},
    )
    assert result.outcome.ending == "faulted"
    assert "times the nameplate's: its inductance is too large" in result.outcome.reason, result.outcome.reason
    advised = re.search(r"with d_inductance_h ([0-9.]+) and", result.outcome.reason)
    assert advised is not None
    assert float(advised[1]) == pytest.approx(0.04325, rel=0.05)
