"""What is too little for a diagnosis is refused in one line, and what is missing is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.judgement import sufficiency
from orchestrator.diagnosis.judgement.sufficiency import missing_contrasts, require_enough
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import NotMeasuredError, SegmentStage
from tests.orchestrator.diagnosis.pieces import NOISE_A, Plan, hold, plan, prepared

NOISE = SensorNoise(NOISE_A**2 * np.eye(2), NOISE_A**2 * np.eye(2), 0.0)
ENOUGH = prepared(plan())


def _only(*stages: SegmentStage) -> PreparedRecording:
    return replace(ENOUGH, pieces=tuple(p for p in ENOUGH.pieces if p.stage in stages))


def test_a_whole_campaign_is_enough() -> None:
    require_enough(ENOUGH, NOISE)


def test_fewer_places_than_requested_are_refused_and_counted() -> None:
    two = prepared([Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0)), Plan(SegmentStage.RESISTANCE, hold(0.0, 1.0))])
    with pytest.raises(NotMeasuredError, match="show 2 operating points"):
        require_enough(two, NOISE)


def test_the_same_place_again_is_no_other() -> None:
    again = prepared([Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0)) for _ in range(20)])
    with pytest.raises(NotMeasuredError, match="show 1 operating point:"):
        require_enough(again, NOISE)


def test_a_sweep_counts_as_two_operating_points(monkeypatch: pytest.MonkeyPatch) -> None:
    sweeps = _only(SegmentStage.CLASSICAL)
    require_enough(sweeps, NOISE)
    monkeypatch.setattr(sufficiency, "OPERATING_POINTS_PER_SWEEP", 1)
    with pytest.raises(NotMeasuredError, match="show 3 operating points"):
        require_enough(sweeps, NOISE)


def test_currents_within_the_noise_are_no_excitation() -> None:
    still = prepared([Plan(SegmentStage.RESISTANCE, hold(0.0, 0.0)) for _ in range(8)])
    with pytest.raises(NotMeasuredError, match="no excitation"):
        require_enough(still, NOISE)


def test_a_rate_with_too_few_samples_between_windows_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sufficiency, "MIN_SAMPLES_PER_TEST_FUNCTION", 1000)
    with pytest.raises(NotMeasuredError, match="too slow"):
        require_enough(ENOUGH, NOISE)


@pytest.mark.parametrize(
    ("without", "code"),
    [
        (SegmentStage.GATES_OFF, "no_gates_off"),
        (SegmentStage.RESISTANCE, "no_holds"),
        (SegmentStage.CLASSICAL, "no_sweep"),
        (SegmentStage.INJECTION, "no_injection"),
    ],
)
def test_what_was_not_measured_is_stated(without: SegmentStage, code: str) -> None:
    kept = _only(*(stage for stage in SegmentStage if stage is not without))
    assert code in {remark.code for remark in missing_contrasts(kept)}
    assert code not in {remark.code for remark in missing_contrasts(ENOUGH)}


def test_a_segment_that_holds_many_sweeps_shows_as_many_places() -> None:
    d = 2.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 600))
    beside = [np.stack([d, np.full_like(d, q)], axis=1) for q in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    require_enough(prepared([Plan(SegmentStage.CLASSICAL, np.concatenate(beside))]), NOISE)
    with pytest.raises(NotMeasuredError, match="show 2 operating points"):
        require_enough(prepared([Plan(SegmentStage.CLASSICAL, np.concatenate(beside[2:3] * 5))]), NOISE)
