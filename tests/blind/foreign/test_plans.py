"""Plans: what they ask for, and that they stay within what a bench gives."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from protocols import SegmentStage
from tests.blind.foreign.machines import FAMILIES
from tests.blind.foreign.plans import PLANS, Bench, Segment


def planned(plan: str, seed: int = 1, family: str = "synrm") -> list[Segment]:
    motor = FAMILIES[family]()
    return list(PLANS[plan](Bench(motor.plate, motor.span_d, np.random.default_rng(seed))))


@pytest.mark.parametrize("plan", PLANS)
def test_a_plan_captures_half_a_minute_at_most_in_known_stages(plan: str) -> None:
    hz = FAMILIES["synrm"]().plate.sampling_hz
    for seed in range(3):
        segments = planned(plan, seed)
        assert sum(len(segment.path_a) for segment in segments) / hz <= 30.0
        assert {segment.stage for segment in segments} <= {stage.value for stage in SegmentStage}
        assert all(np.isfinite(segment.path_a).all() for segment in segments)


@pytest.mark.parametrize(("family", "plan"), list(itertools.product(["ipm_bridges", "synrm"], PLANS)))
def test_set_points_stay_in_the_machines_range(family: str, plan: str) -> None:
    motor = FAMILIES[family]()
    top = motor.plate.top_a
    for segment in planned(plan, 2, family):
        d, q = segment.path_a.T / top
        assert d.min() > motor.span_d[0] - 0.1
        assert d.max() < motor.span_d[1] + 0.1
        assert np.abs(q).max() < 1.1


def test_a_drawn_plan_follows_from_its_seed_alone() -> None:
    def parts(seed: int) -> list[tuple[str, int]]:
        return [(segment.stage, len(segment.path_a)) for segment in planned("drawn", seed)]

    assert parts(5) == parts(5)
    assert len({str(parts(seed)) for seed in range(6)}) > 3


def test_the_plans_differ_in_what_they_lack() -> None:
    stages = {plan: {segment.stage for segment in planned(plan)} for plan in PLANS}
    assert "resistance" not in stages["no_holds"]
    assert "gates_off" not in stages["random_binary"]
    assert any(segment.gap_s for segment in planned("gaps"))
    assert any(np.ptp(s.path_a, axis=0).max() > 0.0 for s in planned("drifting") if s.stage == "resistance")
    assert {s.pwm_ratio for s in planned("standard")} == {1.0, 2.0}
    assert {s.pwm_ratio for s in planned("one_angle")} == {1.0}


def test_logged_injections_without_labels_show_their_target_alone() -> None:
    settings = [segment.settings for segment in planned("chirps") if segment.stage == "injection"]
    assert all(set(one) == {"target_d_a", "target_q_a"} for one in settings)
