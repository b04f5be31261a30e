"""The adaptive stage on a tiny run: it ends when the map is known, keeps its plan, and goes on where it was stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.analysis import injected_points, known_map
from orchestrator.config import load_procedure, make_plan
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, resume_run
from orchestrator.recording import open_recording
from orchestrator.testing import StageConformance
from plugins.drives.simulated import SimulatedOptions, true_flux
from plugins.stages.adaptive import AdaptiveStage
from protocols import Injection, Note, PointDone, ProcedureError, SegmentStage, Stage, StageSufficed, StateChanged
from tests.support.benches import Bench, injections, plan_of
from tests.support.tiny import MOTOR, STAGES, messages_of, run_tiny, tiny_procedure

FIRST = 9
TINY: list[dict[str, Any]] = [*STAGES[:4], {"kind": "adaptive", "until_percent": 0.3}, STAGES[5]]
DRIVE: dict[str, Any] = {
    "watchdog_s": 60.0,
    "plant": {"sensors": {"noise_a": 0.005}, "effects": {"dead_time": {"voltage_v": 0.8}}},
}


class TestAdaptive(StageConformance):
    def make_stage(self) -> Stage:
        return AdaptiveStage()


class StopAtPoint(Interrupts):
    """Asks for a stop once so many points are done."""

    def __init__(self, run: Path, points: int) -> None:
        super().__init__()
        self._run, self._points = run, points

    def check(self) -> None:
        if (self._run / "journal.jsonl").exists() and len(done(self._run)) >= self._points:
            self.stop("enough for now")
        super().check()


def done(run: Path) -> list[PointDone]:
    found = [m for m in messages_of(run) if isinstance(m, PointDone)]
    return [m for m in found if m.id.startswith(AdaptiveStage.name)]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    result = run_tiny(tmp_path_factory.mktemp("adaptive"), stages=TINY, drive=DRIVE)
    assert result.outcome.error is None, result.outcome
    return result.path


def test_it_ends_when_the_band_is_narrow_enough_and_the_run_goes_on(run: Path) -> None:
    (enough,) = [m for m in messages_of(run) if isinstance(m, StageSufficed)]
    assert enough.points_spared > 0
    plan = make_plan(tiny_procedure(run.parent, stages=TINY, drive=DRIVE), None)
    planned = [point for point in plan.points if point.id.startswith(AdaptiveStage.name)]
    assert len(done(run)) + enough.points_spared == len(planned)
    assert messages_of(run)[-1].kind == "run_ended"
    last = [m for m in messages_of(run) if isinstance(m, PointDone)][-1]
    assert last.id.startswith("resistance")
    assert last.points_done == last.points


def test_the_true_flux_is_as_near_as_its_band_says(run: Path) -> None:
    recording = open_recording(run)
    segments = recording.segments(SegmentStage.INJECTION)
    points, capture_s = injected_points(recording, segments, voltage_delay_samples=0.0)
    reach = max(float(np.hypot(s.settings["target_d_a"], s.settings["target_q_a"])) for s in segments)
    known = known_map(points, capture_s, 0.0, reach)
    procedure = tiny_procedure(run.parent, stages=TINY, drive=DRIVE)
    truth = true_flux(SimulatedOptions.model_validate(procedure.drive.options), procedure.motor)
    angle = np.linspace(0.0, 2 * np.pi, 40)
    at = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)], axis=1) for r in (0.9, 1.8, reach)])
    off = known.fit.flux(at)[0] - (truth.flux(at) - truth.flux(np.zeros((1, 2))))
    rated = known.flux_wb((0.0, procedure.motor.rated_current_a or 0.0))
    assert 100.0 * known.band_wb[1] / rated <= 0.3
    assert 100.0 * np.linalg.norm(off, axis=1).max() / rated < 0.3


def test_it_computes_disarmed_and_says_the_band_and_the_time_that_is_left(run: Path) -> None:
    states = [m.target for m in messages_of(run) if isinstance(m, StateChanged)]
    before = [states[k - 1] for k, state in enumerate(states) if state == "choosing_points"]
    assert before
    assert set(before) <= {"stopping", "choosing_points"}
    texts = [m.text for m in messages_of(run) if isinstance(m, Note) and "rated flux" in m.text]
    assert all("s more for 0.3 %" in text for text in texts[:-1])
    assert texts[-1].startswith(f"{len(done(run))} points")


def test_points_stay_within_the_plan(run: Path) -> None:
    plan = make_plan(tiny_procedure(run.parent, stages=TINY, drive=DRIVE), None)
    planned = [p.excitation for p in plan.points if p.id.startswith("adaptive") and isinstance(p.excitation, Injection)]
    longest = max(point.longest_current_a for point in planned)
    for message in done(run):
        settings = message.segment.settings
        assert float(np.hypot(settings["target_d_a"], settings["target_q_a"])) <= longest * (1 + 1e-6)
        assert message.segment.samples <= 1e4 * planned[0].duration_s + 1
        assert settings["amplitude_v"] == planned[0].amplitude_v


def test_a_run_that_is_stopped_within_it_chooses_what_it_would_have_chosen(run: Path, tmp_path: Path) -> None:
    stop = StopAtPoint(tmp_path / "run", FIRST + 4)
    result = run_tiny(tmp_path, stages=TINY, drive=DRIVE, interrupts=stop)
    assert result.outcome.ending == "aborted"
    result = resume_run(result.path, RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished", result.outcome
    chosen = [(m.id, m.segment.settings) for m in done(result.path)]
    assert chosen == [(m.id, m.segment.settings) for m in done(run)]


def test_the_lock_is_checked_at_the_largest_torque_that_it_may_ask_for() -> None:
    plan = make_plan(load_procedure("adaptive"), None)
    largest = max(abs(p.target_q_a) for p in injections(plan) if p.duration_s == pytest.approx(0.4))
    checked = [p.excitation for p in plan.points if p.stage is SegmentStage.LOCK_CHECK]
    assert max(abs(one.target_q_a) for one in checked if isinstance(one, Injection)) == pytest.approx(largest)


def test_too_little_time_for_the_first_points_is_one_line(pm400: Bench) -> None:
    with pytest.raises(ProcedureError, match=r"stages\.0\.longest_s: 2 s are the time of 3 points"):
        plan_of(pm400, {"kind": "adaptive", "longest_s": 2.0})


def test_a_plan_is_the_most_that_it_may_take(pm400: Bench) -> None:
    plan = plan_of(pm400, {"kind": "adaptive", "longest_s": 20.0})
    assert 19.0 < sum(point.seconds for point in plan.points) <= 20.0
    assert MOTOR["rated_current_rms_a"] < max(point.longest_current_a for point in injections(plan))
