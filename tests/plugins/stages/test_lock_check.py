"""The lock check: how much torque, in which order."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from orchestrator.config import make_plan, nominal_ripple_a
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, resume_run
from orchestrator.testing import StageConformance
from plugins.stages.lock_check import LockCheckStage
from protocols import Injection, PointDone, Stage
from tests.support.benches import Bench, injections, plan_of, targets
from tests.support.tiny import messages_of, run_tiny


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
    assert all(isinstance(p.excitation, Injection) for p in plan.points)


def test_at_rest_no_phase_current_passes_zero_within_the_ripple(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "lock_check"})
    ripple_a = nominal_ripple_a(injections(plan, "lock_check")[0], plan.procedure.motor)
    d_a, q_a = targets(plan)[0]
    assert q_a == 0.0
    assert 0.5 * d_a > ripple_a  # phases b and c carry half the current
    assert max(math.hypot(*target) for target in targets(plan)) + ripple_a < plan.procedure.limits.current_a


def test_a_weakly_salient_motor_has_a_rest_more_and_the_plan_holds_the_longest_captures(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "lock_check", "duration_s": 0.5, "torque_current_a": 2.0})
    motor = procedure.motor.model_copy(update={"q_inductance_h": procedure.motor.d_inductance_h})
    plan = make_plan(procedure.model_copy(update={"motor": motor}), None)
    assert [q for _, q in targets(plan)] == [0, 0, 2, 0, -2, 0]
    assert [i.duration_s for i in injections(plan, "lock_check")] == [0.5] + 5 * [4.0]


@pytest.mark.parametrize(
    ("limits", "longest_s"), [({"energy_j": 4000.0}, 1.7), ({"duration_s": 200.0}, 1.5), ({"energy_j": 1000.0}, 0.5)]
)
def test_longer_captures_add_a_twentieth_of_the_limits_at_most(
    pm400: Bench, limits: dict[str, float], longest_s: float
) -> None:
    procedure = pm400.procedure(
        {"kind": "lock_check", "duration_s": 0.5, "torque_current_a": 2.0, "rest_current_a": 1.0},
        {"kind": "lock_check", "max_duration_ratio": 1.0},
    )
    motor = procedure.motor.model_copy(update={"q_inductance_h": procedure.motor.d_inductance_h})
    allowed = procedure.limits.model_copy(update=limits)
    plan = make_plan(procedure.model_copy(update={"motor": motor, "limits": allowed}), None)
    own = [point.excitation for point in plan.points_of(0)]
    assert max(injection.captured_s for injection in own) == pytest.approx(longest_s, rel=0.05)
    heat_j = 1.5 * 4.25 * sum(math.hypot(*i.start_dq_a) ** 2 * (i.captured_s - 0.5) for i in own)
    assert heat_j <= 0.5 * 0.05 * limits.get("energy_j", math.inf) * 1.05
    assert sum(i.captured_s - 0.5 for i in own) <= 0.5 * 0.05 * limits.get("duration_s", math.inf) * 1.05


STAGES: list[dict[str, Any]] = [
    {"kind": "alignment", "settle_s": 0.5, "duration_s": 0.02},
    {"kind": "lock_check", "settle_s": 0.2, "duration_s": 0.2, "max_duration_ratio": 8.0},
]
NOISY: dict[str, Any] = {"plant": {"brake": {"start": "engaged"}, "sensors": {"noise_a": 0.01}}}


def lock_points(path: Path) -> list[tuple[str, int, float]]:
    segments = [m.segment for m in messages_of(path) if isinstance(m, PointDone) and "lock" in m.id]
    return [(segment.id, segment.samples, segment.settings["target_q_a"]) for segment in segments]


def test_a_run_stopped_between_its_captures_goes_on_as_it_would_have(tmp_path: Path) -> None:
    for folder in ("whole", "part"):
        (tmp_path / folder).mkdir()
    whole = run_tiny(tmp_path / "whole", stages=STAGES, drive=NOISY)
    assert whole.outcome.ending == "finished", whole.outcome
    points = lock_points(whole.path)
    assert len(points) == 6
    assert points[0][1] < points[1][1] < 8 * points[0][1]
    part = run_tiny(tmp_path / "part", stages=STAGES, drive=NOISY, interrupts=StopAtPoint(tmp_path / "part" / "run", 3))
    assert part.outcome.ending == "aborted"
    assert len(lock_points(part.path)) == 3
    resumed = resume_run(part.path, RunServices(AbsentOperator(), Interrupts()))
    assert resumed.outcome.ending == "finished", resumed.outcome
    assert lock_points(part.path) == points


class StopAtPoint(Interrupts):
    """Asks for a stop once so many points of the lock check are done."""

    def __init__(self, run: Path, points: int) -> None:
        super().__init__()
        self._run, self._points = run, points

    def check(self) -> None:
        if (self._run / "journal.jsonl").exists() and len(lock_points(self._run)) >= self._points:
            self.stop("enough for now")
        super().check()
