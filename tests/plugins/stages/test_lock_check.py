"""The lock check: how much torque, in which order."""

from __future__ import annotations

import math
from typing import Any

import pytest

from orchestrator.config import make_plan, nominal_ripple_a
from orchestrator.testing import StageConformance
from plugins.stages.lock_check import LockCheckStage
from protocols import Injection, Stage
from tests.support.benches import Bench, injections, plan_of, targets


class TestLockCheck(StageConformance):
    def make_stage(self) -> Stage:
        return LockCheckStage()


def test_the_lock_is_tried_with_the_largest_torque_current_of_what_follows(pm400: Bench) -> None:
    def torque(*later: dict[str, Any]) -> float:
        plan = make_plan(pm400.procedure({"kind": "lock_check"}, *later), None)
        return max(i.target_q_a for i in injections(plan, "lock_check"))

    assert torque({"kind": "classical", "amplitude_a": 1.5, "held_a": [-2.5, 0.5]}) == 2.5
    assert torque({"kind": "classical", "axes": ["q"], "amplitude_a": 1.5, "held_a": [-2.5]}) == 1.5
    assert torque({"kind": "classical", "axes": ["dq"], "amplitude_a": 2.0}) == pytest.approx(math.sqrt(2))
    assert torque({"kind": "injection", "points_a": [[0.0, -1.75], [2.0, 1.0]]}) == 1.75
    assert torque({"kind": "resistance", "points_a": [[3.0, 0.25]]}) == 0.25
    assert torque() == pytest.approx(2.9)


def test_the_lock_check_goes_from_nothing_to_both_torques_and_back(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "lock_check", "torque_current_a": 2.0, "rest_current_a": 1.0})
    assert targets(plan) == [(1, 0), (1, 2), (1, 0), (1, -2), (1, 0)]
    assert [p.settings["torque"] for p in plan.points] == [0, 1, 0, -1, 0]
    assert all(isinstance(p.excitation, Injection) for p in plan.points)


def test_at_rest_no_phase_current_passes_zero_within_the_ripple(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "lock_check"})
    ripple_a = nominal_ripple_a(injections(plan, "lock_check")[0], plan.procedure.motor)
    d_a, q_a = targets(plan)[0]
    assert q_a == 0.0
    assert 0.5 * d_a > ripple_a  # phases b and c carry half the current
    assert max(math.hypot(*target) for target in targets(plan)) + ripple_a < plan.procedure.limits.current_a
