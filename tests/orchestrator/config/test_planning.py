"""Plans: which points, in which order, under which names and with which settings."""

from __future__ import annotations

import math
from typing import Any

import pytest

from orchestrator.config import load_procedure, make_plan
from protocols import GatesOff, Hold, ProcedureError, Segment, SegmentStage, shipped_procedures
from tests.support.benches import Bench, plan_of, targets


@pytest.mark.parametrize("name", shipped_procedures())
def test_ids_count_each_stage_over_the_whole_procedure(name: str) -> None:
    plan = make_plan(load_procedure(name), None)
    for kind in {stage.name for stage in plan.stages}:
        ids = [point.id for point in plan.points if plan.stages[point.stage_index].name == kind]
        assert ids == [f"{kind}-{k:03d}" for k in range(len(ids))]
    for point in plan.points:
        Segment(id=point.id, stage=point.stage, start_s=0.0, samples=1, settings=point.settings)


@pytest.mark.parametrize("name", shipped_procedures())
def test_points_are_in_the_order_of_their_stages(name: str) -> None:
    plan = make_plan(load_procedure(name), None)
    indices = [point.stage_index for point in plan.points]
    assert indices == sorted(indices)
    by_stage = [point for index in range(len(plan.stages)) for point in plan.points_of(index)]
    assert by_stage == list(plan.points)
    assert all(plan.stages[point.stage_index].records_as is point.stage for point in plan.points)


def test_no_current_is_a_negative_zero(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "lock_check"}, {"kind": "injection"}, {"kind": "resistance"})
    zeros = [value for target in targets(plan) for value in target if value == 0]
    assert zeros
    assert all(math.copysign(1.0, value) > 0 for value in zeros)


def test_held_currents_are_the_grids_rows(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "injection", "held_a": [0.0, 1.0], "range_a": 2.0, "step_a": 1.0})
    assert {d for d, _ in targets(plan)} == {0.0, 1.0}
    assert len(plan.points) == 10


def test_a_second_amplitude_is_a_second_sweep_backwards(pm400: Bench) -> None:
    points = [[1.0, 0.0], [0.0, 1.0]]
    plan = plan_of(pm400, {"kind": "injection", "points_a": points, "amplitudes_v": [40.0, 20.0]})
    assert [(p.target, p.settings["amplitude_v"]) for p in plan.points] == [
        ((1.0, 0.0), 40.0),
        ((0.0, 1.0), 40.0),
        ((0.0, 1.0), 20.0),
        ((1.0, 0.0), 20.0),
    ]


def test_resistance_points_repeat_at_each_pwm_frequency_and_only_another_than_the_drives_is_stated(
    pm400: Bench,
) -> None:
    stage = {"kind": "resistance", "points_a": [[1.0, 0.0]], "pwm_frequencies_hz": [10_000.0, 20_000.0]}
    own, other = plan_of(pm400, stage).points
    assert own.settings == {"current_d_a": 1.0, "current_q_a": 0.0}
    assert other.settings == {"current_d_a": 1.0, "current_q_a": 0.0, "pwm_frequency_hz": 20_000.0}
    assert [p.excitation.pwm_frequency_hz for p in (own, other)] == [10_000.0, 20_000.0]


def test_an_anchor_is_one_point_and_marked(pm400: Bench) -> None:
    stages: list[dict[str, Any]] = [
        {"kind": kind, "anchor": True} for kind in ("resistance", "injection", "resistance")
    ]
    plan = plan_of(pm400, *stages)
    assert len(plan.points) == 3
    assert all(point.settings["anchor"] is True for point in plan.points)
    assert plan.points[0].excitation == plan.points[2].excitation


def test_settings_say_what_was_requested_as_the_recording_format_has_them(pm400: Bench) -> None:
    stages = [
        {"kind": "gates_off", "duration_s": 2.0},
        {"kind": "alignment", "current_a": 2.0},
        {"kind": "classical", "axes": ["q", "dq"], "amplitude_a": 3.0, "held_a": [-3.0], "periods": 3},
        {"kind": "injection", "points_a": [[0.0, 1.0]], "amplitudes_v": [40.0], "rotation_hz": 2.0},
    ]
    gates_off, alignment, on_q, on_both, injection = plan_of(pm400, *stages).points
    sweep = {"amplitude_a": 3.0, "period_s": 2.0, "periods": 3}
    assert gates_off.settings == {}
    assert alignment.settings == {"current_d_a": 2.0, "current_q_a": 0.0}
    assert on_q.settings == {"swept_axis": "q", "held_a": -3.0, **sweep}
    assert on_both.settings == {"swept_axis": "dq", **sweep}
    assert injection.settings == {
        "target_d_a": 0.0,
        "target_q_a": 1.0,
        "amplitude_v": 40.0,
        "frequency_hz": 500.0,
        "rotation_hz": 2.0,
        "waveform": "square",
    }
    assert isinstance(gates_off.excitation, GatesOff)
    assert isinstance(alignment.excitation, Hold)
    assert [p.target for p in (gates_off, alignment, on_q, injection)] == [None, (2.0, 0.0), None, (0.0, 1.0)]


def test_seconds_hold_the_settling_and_captured_seconds_do_not(pm400: Bench) -> None:
    stages = [
        {"kind": "gates_off", "duration_s": 2.0},
        {"kind": "resistance", "points_a": [[1.0, 0.0]], "settle_s": 0.5, "duration_s": 1.0},
        {"kind": "classical", "axes": ["dq"], "periods": 3, "settle_s": 0.5},
        {"kind": "injection", "points_a": [[1.0, 0.0]], "settle_s": 0.5, "discard_s": 0.25, "duration_s": 1.0},
    ]
    plan = plan_of(pm400, *stages)
    assert [point.captured_s for point in plan.points] == [2.0, 1.0, 6.0, 1.0]
    assert [point.seconds for point in plan.points] == [2.0, 1.5, 6.5, 1.75]


@pytest.mark.parametrize(
    "stage",
    [
        {"kind": "classical", "axes": []},
        {"kind": "classical", "axes": ["q"], "held_a": []},
        {"kind": "injection", "points_a": []},
        {"kind": "resistance", "points_a": []},
    ],
)
def test_a_stage_without_a_point_is_refused(pm400: Bench, stage: dict[str, Any]) -> None:
    with pytest.raises(ProcedureError, match=r"stages\.0: .*without a point"):
        plan_of(pm400, stage)


def test_full_holds_what_parts_effects() -> None:
    plan = make_plan(load_procedure("full"), None)
    stages = [stage.name for stage in plan.stages]
    injections = [p for p in plan.points if p.stage is SegmentStage.INJECTION]
    anchors = [p for p in plan.points if p.settings.get("anchor")]
    assert {p.settings["frequency_hz"] for p in injections} == {250.0, 500.0, 1000.0}
    assert len({p.settings["amplitude_v"] for p in injections if p.settings["frequency_hz"] == 500.0}) == 2
    assert len({p.settings.get("pwm_frequency_hz") for p in plan.points if p.stage is SegmentStage.RESISTANCE}) >= 2
    assert len({p.excitation.rotor_angle_rad for p in injections}) == 2
    # Cold and warm, at one angle of the rotor, and the lock is checked wherever it is held.
    assert len(anchors) == 4
    assert {p.excitation.rotor_angle_rad for p in anchors} == {0.0}
    assert stages.count("lock_check") == stages.count("alignment") == 2


def test_a_setting_that_follows_from_an_impossible_limit_is_one_line_with_its_stage() -> None:
    procedure = load_procedure("quick", overrides=["limits.current_a=1e-30"])
    with pytest.raises(ProcedureError) as refused:
        make_plan(procedure, None)
    assert "stages." in str(refused.value)
    assert "is too small a number" in str(refused.value)
    assert "\n" not in str(refused.value)
