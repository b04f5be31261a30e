"""Voltage steps: the planned points, who refuses them, and the estimated map of a plant whose own is known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.numerics.frames import to_dq
from orchestrator.recording import open_recording
from orchestrator.testing import StageConformance
from plugins.stages.steps import StepsStage
from protocols import Capabilities, CapabilityError, ExcitationKind, Stage, VoltageSteps
from tests.plugins.stages.truth import errors_percent, estimated
from tests.support.benches import Bench
from tests.support.tiny import run_tiny

STAGES: list[dict[str, Any]] = [
    {"kind": "resistance", "settle_s": 0.15, "duration_s": 0.05, "points_a": [[1.0, 0.0], [-1.0, 0.0], [2.5, 0.0]]},
    {"kind": "injection", "pattern": "corners", "range_a": 2.0, "settle_s": 0.2, "duration_s": 0.1},
    {"kind": "steps", "swings": 30},
    {"kind": "estimate", "estimators": ["resistance", "injection", "steps", "step_resistance", "energy"]},
]
DRIVE: dict[str, Any] = {
    "watchdog_s": 60.0,
    "plant": {"sensors": {"noise_a": 0.005}, "effects": {"dead_time": {"voltage_v": 0.8}}},
}


ALL = frozenset(get_args(ExcitationKind))


class TestSteps(StageConformance):
    def make_stage(self) -> Stage:
        return StepsStage()


def planned(bench: Bench, capabilities: Capabilities | None = None, **settings: Any) -> list[VoltageSteps]:
    plan = make_plan(bench.procedure({"kind": "steps", **settings}), capabilities)
    check_plan(plan, capabilities)
    return [p.excitation for p in plan.points if isinstance(p.excitation, VoltageSteps)]


def test_each_axis_alone_and_both_at_once_at_two_voltages(pm400: Bench) -> None:
    d, q, both, *slower = planned(pm400)
    assert (d.voltage_q_v, q.voltage_d_v) == (0.0, 0.0)
    assert d.turn_d_a == q.turn_q_a == pytest.approx(math.sqrt(2.0) * both.turn_d_a)
    # 40 rows of a swing at 10 kHz, by the nameplate's inductances.
    assert 2.0 * d.turn_d_a * 0.04325 / d.voltage_d_v == pytest.approx(4e-3, rel=0.05)
    assert 2.0 * q.turn_q_a * 0.06905 / q.voltage_q_v == pytest.approx(4e-3, rel=0.05)
    assert [s.voltage_v for s in slower] == pytest.approx([0.5 * s.voltage_v for s in (d, q, both)])
    assert [s.duration_s for s in slower] == pytest.approx([2.0 * s.duration_s for s in (d, q, both)])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"turn_a": 6.0}, "stages.0.turn_a: steps reaches 6"),
        ({"voltages_v": [200.0, 90.0]}, "stages.0.voltages_v: steps needs 200 V, limits.voltage_v is 150 V"),
        ({"voltages_v": [15.0, 90.0]}, "do not drive 2.9 A through R_s of 4.25 ohm in time: at least 18.5 V"),
        ({"voltages_v": [149.0, 90.0], "turn_a": 0.5}, "rows from one turn to the next at 10000 Hz: at most"),
    ],
)
def test_what_cannot_be_is_refused_with_its_setting(pm400: Bench, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(CapabilityError) as refused:
        planned(pm400, pm400.capabilities(excitations=ALL, watchdog_covers=ALL), **settings)
    assert message in str(refused.value)


def test_a_drive_whose_programs_cannot_turn_a_voltage_is_refused_by_name(pm400: Bench) -> None:
    with pytest.raises(CapabilityError, match=r"the drive 'bench drive' has no steps; it has gates_off, hold"):
        planned(pm400, pm400.capabilities())


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("steps")
    result = run_tiny(folder, stages=STAGES, drive=DRIVE, limits={"current_a": 5.0, "voltage_v": 150.0})
    assert result.outcome.ending == "finished"
    return folder / "run"


@pytest.mark.slow
def test_the_voltage_turns_where_the_current_has_passed_its_limit(run: Path) -> None:
    recording = open_recording(run)
    segment = next(s for s in recording.segments() if s.id == "steps-000")
    capture = recording.load(segment)
    i, v = to_dq(capture.i_ab, segment.rotor_angle_rad), to_dq(capture.v_ab, segment.rotor_angle_rad)
    turn, volts = segment.settings["turn_d_a"], segment.settings["voltage_d_v"]
    np.testing.assert_allclose(np.abs(v[:, 0]), volts, rtol=1e-6)
    turned = np.flatnonzero(np.diff(np.sign(v[:, 0]))) + 1
    assert len(turned) > 50
    assert np.abs(i[turned, 0]).min() >= turn
    before = np.delete(np.arange(len(i) - 1), turned - 1)
    assert (np.abs(i[before + 1, 0])[np.sign(i[before + 1, 0]) == np.sign(v[before, 0])] < turn).all()


@pytest.mark.slow
def test_one_map_comes_of_steps_and_injection_and_it_is_right(run: Path) -> None:
    report = estimated(run)
    assert report.method == "energy"
    assert report.usable
    assert errors_percent(run, "steps") < 0.1
    assert errors_percent(run, "energy") < 0.15


@pytest.mark.slow
def test_the_loops_tell_the_resistance_and_what_dead_time_keeps(run: Path) -> None:
    report = estimated(run)
    remarks = {remark.code: remark for remark in report.remarks}
    assert remarks["steps.inverter_loss"].values["lost_v"] == pytest.approx(0.8, abs=0.05)
    assert report.resistance is not None
    assert report.resistance.low < 4.25 < report.resistance.high


def test_the_shipped_procedure_is_planned_within_its_limits(pm400: Bench) -> None:
    able = pm400.capabilities(excitations=ALL, watchdog_covers=ALL)
    plan = make_plan(load_procedure("steps"), able)
    check_plan(plan, able)
    assert sum(isinstance(p.excitation, VoltageSteps) for p in plan.points) == 6
