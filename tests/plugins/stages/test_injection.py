"""The injection stage: its amplitude, its turns, its points."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, resume_run
from orchestrator.testing import StageConformance
from plugins.stages.injection import InjectionStage
from protocols import Injection, PointDone, ProcedureError, SegmentStage, Stage, StageSufficed, StateChanged
from tests.support.benches import PM400, Bench, injections, plan_of, targets
from tests.support.tiny import STAGES, messages_of, run_tiny


class TestInjection(StageConformance):
    def make_stage(self) -> Stage:
        return InjectionStage()


@pytest.mark.parametrize("waveform", ["square", "sine"])
@pytest.mark.parametrize("frequency", [None, 250.0, 1000.0])
def test_injection_swings_the_flux_by_a_fifth_of_the_rated_currents(
    pm400: Bench, waveform: str, frequency: float | None
) -> None:
    stage = {"kind": "injection", "waveform": waveform, "frequency_hz": frequency}
    point = injections(make_plan(pm400.procedure(stage, limits={"current_a": 5.0, "voltage_v": 300.0}), None))[0]
    swing = point.amplitude_v / point.frequency_hz / (4.0 if waveform == "square" else 2 * math.pi)
    assert swing == pytest.approx(0.2 * 1.66 * math.sqrt(2) * 0.04325, rel=0.05)


def test_a_ratio_scales_the_frequency_and_the_voltage_with_it(pm400: Bench) -> None:
    limits = {"current_a": 5.0, "voltage_v": 300.0}
    one, two = (
        injections(make_plan(pm400.procedure({"kind": "injection", "frequency_ratio": ratio}, limits=limits), None))[0]
        for ratio in (1.0, 2.0)
    )
    assert two.frequency_hz == 2.0 * one.frequency_hz == 1000.0
    assert two.amplitude_v == pytest.approx(2.0 * one.amplitude_v, rel=0.05)


def test_corners_are_three_by_three(pm400: Bench) -> None:
    stage = {"kind": "injection", "pattern": "corners", "range_a": 2.0}
    points = targets(make_plan(pm400.procedure(stage), None))
    assert sorted(points) == [(d, q) for d in (-2.0, 0.0, 2.0) for q in (-2.0, 0.0, 2.0)]


def test_injection_leaves_room_for_the_resistive_drop(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "injection"}, limits={"current_a": 5.0, "voltage_v": 40.0})
    point = injections(make_plan(procedure, None))[0]
    assert point.amplitude_v + 4.25 * 5.0 <= 40.0


@pytest.mark.parametrize("sampling_hz", [8e3, 1e4, 16e3, 4e4])
def test_injection_has_a_whole_and_even_number_of_samples_a_period(pm400: Bench, sampling_hz: float) -> None:
    drive = pm400.capabilities(sampling_frequency_hz=sampling_hz)
    point = injections(make_plan(pm400.procedure({"kind": "injection"}), drive))[0]
    assert sampling_hz / point.frequency_hz == 20


@given(rotation=st.none() | st.floats(0.1, 20.0), duration=st.none() | st.floats(0.1, 20.0))
def test_the_duration_holds_whole_turns_unless_both_are_given(rotation: float | None, duration: float | None) -> None:
    stage = {"kind": "injection", "rotation_hz": rotation, "duration_s": duration}
    point = injections(make_plan(PM400.procedure(stage), None))[0]
    turns = point.rotation_hz * point.duration_s
    assert rotation in (None, point.rotation_hz)
    assert duration in (None, point.duration_s)
    if rotation is None or duration is None:
        assert turns == pytest.approx(round(turns))
        assert turns > 0.5


def test_a_default_grid_is_clipped_to_the_limit_and_says_so(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "injection"}, limits={"current_a": 4.0, "voltage_v": 150.0})
    plan = make_plan(procedure, None)
    assert 0 < len(plan.points) < 25
    assert all(p.target is not None and math.hypot(*p.target) < 4.0 for p in plan.points)
    (note,) = plan.notes
    assert f"{25 - len(plan.points)} of 25 points left out" in note
    check_plan(plan, None)


def test_a_ripple_that_leaves_no_room_is_refused_by_its_amplitude(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "injection", "amplitudes_v": [40.0], "frequency_hz": 20.0})
    with pytest.raises(ProcedureError, match=r"stages\.0\.amplitudes_v: .*ripple of 11\.6 A"):
        make_plan(procedure, None)


def test_what_was_given_is_taken_as_it_is(pm400: Bench) -> None:
    stage = {
        "kind": "injection",
        "points_a": [[0.123456, 0.0]],
        "amplitudes_v": [33.3],
        "frequency_hz": 625.0,
        "rotation_hz": 1.7,
        "settle_s": 0.111,
        "duration_s": 0.777,
        "control": {"bandwidth_hz": 31.0},
    }
    (point,) = injections(make_plan(pm400.procedure(stage), None))
    assert (point.target_d_a, point.amplitude_v, point.frequency_hz) == (0.123456, 33.3, 625.0)
    assert (point.rotation_hz, point.settle_s, point.duration_s) == (1.7, 0.111, 0.777)
    assert point.control.bandwidth_hz == 31.0


def test_the_papers_injection_steps_along_the_same_paths() -> None:
    plan = make_plan(load_procedure("paper"), None)
    points = [p.excitation for p in plan.points if p.stage is SegmentStage.INJECTION]
    assert len(points) == 15 * 61
    for point in points:
        assert isinstance(point, Injection)
        assert (point.amplitude_v, point.frequency_hz, point.rotation_hz, point.duration_s) == (40.0, 500.0, 1.0, 5.0)
        assert (point.waveform, point.settle_s) == ("square", 0.25)
    reached = [p.target for p in plan.points if p.stage is SegmentStage.INJECTION and p.target is not None]
    for k in range(15):
        path = reached[61 * k : 61 * (k + 1)]
        lengths = [math.dist(a, b) for a, b in pairwise(path)]
        assert lengths == pytest.approx([0.1] * 60, abs=1e-6)
        assert (0.0 in path[30]) or path[30] == (0.0, 0.0)
    assert max(math.hypot(*target) for target in reached) == pytest.approx(math.hypot(3, 3))


def test_a_grid_goes_back_and_forth(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "injection", "range_a": 2.0, "step_a": 1.0})
    reached = targets(plan)
    assert len(reached) == len(set(reached)) == 25
    assert reached[:6] == [(-2, -2), (-2, -1), (-2, 0), (-2, 1), (-2, 2), (-1, 2)]
    assert all(math.dist(a, b) == pytest.approx(1.0) for a, b in pairwise(reached))


@pytest.mark.parametrize("pattern", ["grid", "paths"])
def test_a_slip_of_the_decimal_point_does_not_fill_the_memory(pm400: Bench, pattern: str) -> None:
    with pytest.raises(ProcedureError, match=r"stages\.0\.step_a: .*more than"):
        plan_of(pm400, {"kind": "injection", "pattern": pattern, "step_a": 1e-9})


SHARP: dict[str, Any] = {
    "kind": "injection",
    "points_a": [[d, q] for d in (-2.0, 0.0, 2.0) for q in (-2.0, 0.0, 2.0)],
    "settle_s": 0.2,
    "duration_s": 0.2,
    "most_between": 5,
    "steepest": 1.15,
}


def test_points_between_are_planned_where_the_current_is_largest() -> None:
    points = make_plan(PM400.procedure(SHARP), None).points
    assert [point.spare for point in points] == [False] * 9 + [True] * 5
    assert {math.hypot(*point.target) for point in points[9:] if point.target} == {math.hypot(2.0, 2.0)}


def measured(path: Path) -> list[tuple[float, float]]:
    targets = [m.segment.settings for m in messages_of(path) if isinstance(m, PointDone) and "injection" in m.id]
    return [(one["target_d_a"], one["target_q_a"]) for one in targets]


def test_steps_in_which_the_iron_bends_are_halved_and_the_run_goes_on_as_it_would_have(tmp_path: Path) -> None:
    stages = [STAGES[0], SHARP, STAGES[5]]
    plant = {"plant": {"magnetics": {"kind": "nameplate", "q_fall": 0.5}, "sensors": {"noise_a": 0.005}}}
    for folder in ("whole", "part"):
        (tmp_path / folder).mkdir()
    whole = run_tiny(tmp_path / "whole", stages=stages, drive=plant)
    assert whole.outcome.ending == "finished", whole.outcome
    points = measured(whole.path)
    assert 9 < len(points) <= 14
    assert set(points[9:]) <= {(d, q) for d in (-2.0, 0.0, 2.0) for q in (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)} | {
        (d, q) for d in (-1.0, 1.0) for q in (-2.0, 0.0, 2.0)
    }
    states = [m.target for m in messages_of(whole.path) if isinstance(m, StateChanged)]
    assert states[states.index("looking_between_points") - 1] == "stopping"
    stop = StopAtPoint(tmp_path / "part" / "run", 10)
    part = run_tiny(tmp_path / "part", stages=stages, drive=plant, interrupts=stop)
    assert part.outcome.ending == "aborted"
    resumed = resume_run(part.path, RunServices(AbsentOperator(), Interrupts()))
    assert resumed.outcome.ending == "finished"
    assert measured(part.path) == points


def test_a_motor_that_bends_slowly_gets_none(tmp_path: Path) -> None:
    stages = [STAGES[0], {**SHARP, "steepest": 1.6}]
    plant = {"plant": {"magnetics": {"kind": "nameplate", "d_fall": 0.2, "q_fall": 0.2}}}
    result = run_tiny(tmp_path, stages=stages, drive=plant)
    assert len(measured(result.path)) == 9
    (enough,) = [m for m in messages_of(result.path) if isinstance(m, StageSufficed)]
    assert enough.points_spared == 5


class StopAtPoint(Interrupts):
    """Asks for a stop once so many points are injected at."""

    def __init__(self, run: Path, points: int) -> None:
        super().__init__()
        self._run, self._points = run, points

    def check(self) -> None:
        if (self._run / "journal.jsonl").exists() and len(measured(self._run)) >= self._points:
            self.stop("enough for now")
        super().check()
