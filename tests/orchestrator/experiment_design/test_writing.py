"""Points that become stages of a procedure are those points again when it is planned."""

from __future__ import annotations

import pytest

from orchestrator.experiment_design.writing import stages_of
from protocols import GatesOff, Trapezoid
from tests.orchestrator.experiment_design.plans import GATES_OFF, HOLDS, RIPPLE, SWEEPS, plan

AT_TWO = {**HOLDS, "pwm_frequencies_hz": [10_000.0, 20_000.0]}
TWICE = {**RIPPLE, "amplitude_ratios": [1.0, 0.5]}
SINE = {**RIPPLE, "waveform": "sine", "discard_s": 0.1}
SLOW = {**HOLDS, "control": {"bandwidth_hz": 10.0}}


@pytest.mark.parametrize("stage", [GATES_OFF, HOLDS, AT_TWO, SWEEPS, RIPPLE, TWICE, SINE, SLOW])
def test_a_stage_comes_back_as_it_was_measured(stage: dict[str, object]) -> None:
    before = plan(stage)
    after = plan(*stages_of([(p, 1) for p in before.points], before.procedure.control))
    assert sorted(str(p.excitation) for p in after.points) == sorted(str(p.excitation) for p in before.points)


def test_an_anchor_stays_one() -> None:
    before = plan({"kind": "resistance", "anchor": True})
    (stage,) = stages_of([(p, 1) for p in before.points], before.procedure.control)
    assert stage["anchor"] is True


@pytest.mark.parametrize("stage", [GATES_OFF, HOLDS, SWEEPS, RIPPLE])
def test_what_is_measured_more_often_lasts_longer(stage: dict[str, object]) -> None:
    before = plan(stage)
    after = plan(*stages_of([(p, 3) for p in before.points], before.procedure.control))
    assert len(after.points) == len(before.points)
    captured = sum(p.captured_s for p in before.points)
    assert sum(p.captured_s for p in after.points) == pytest.approx(3.0 * captured)


def test_alike_points_become_one_stage_and_others_do_not() -> None:
    points = plan(GATES_OFF, HOLDS, SWEEPS).points
    stages = stages_of([(p, 2 if k == 1 else 1) for k, p in enumerate(points)], plan(HOLDS).procedure.control)
    assert [stage["kind"] for stage in stages] == ["gates_off", "resistance", "resistance", "classical", "classical"]
    assert isinstance(points[0].excitation, GatesOff)
    assert isinstance(points[-1].excitation, Trapezoid)
