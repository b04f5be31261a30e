"""The classical stage: what is swept, and how far."""

from __future__ import annotations

import math

import pytest

from orchestrator.config import load_procedure, make_plan
from orchestrator.testing import StageConformance
from plugins.stages.classical import ClassicalStage
from protocols import Stage, Trapezoid
from tests.support.benches import Bench, trapezoids


class TestClassical(StageConformance):
    def make_stage(self) -> Stage:
        return ClassicalStage()


def test_a_narrow_limit_scales_the_amplitudes_down_and_keeps_the_corners_inside(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "classical"}, limits={"current_a": 2.0, "voltage_v": 150.0})
    plan = make_plan(procedure, None)
    assert trapezoids(plan)[0].amplitude_a == pytest.approx(1.6)
    assert all(math.hypot(t.held_a, t.amplitude_a) <= 2.0 for t in trapezoids(plan))


def test_the_papers_sweeps_are_the_papers() -> None:
    plan = make_plan(load_procedure("paper"), None)
    sweeps = [p.excitation for p in plan.points if isinstance(p.excitation, Trapezoid)]
    held = [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]
    assert [(t.swept_axis, t.held_a) for t in sweeps] == [
        *(("q", h) for h in held),
        *(("d", h) for h in held),
        ("dq", 0),
    ]
    assert {(t.amplitude_a, t.period_s, t.periods) for t in sweeps} == {(3.0, 2.0, 10)}
    assert {(t.control.bandwidth_hz, round(t.control.damping, 6)) for t in sweeps} == {(25.0, 0.707107)}
    assert sum(t.period_s * t.periods for t in sweeps) == 300.0
