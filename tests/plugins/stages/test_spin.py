"""A turning rotor: the planned points, who refuses them, and the estimates of a plant whose own map is known."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.recording import open_recording
from orchestrator.testing import StageConformance
from plugins.drives.simulated.options import SimulatedOptions
from plugins.drives.simulated.truth import true_flux
from plugins.stages.spin import SpinStage
from protocols import Capabilities, CapabilityError, ExcitationKind, RunEnded, Spin, Stage
from tests.plugins.stages.truth import errors_percent, estimated, flux_errors
from tests.support.benches import Bench
from tests.support.tiny import messages_of, run_tiny, tiny_procedure

ALL = frozenset(get_args(ExcitationKind))
RELEASE: dict[str, Any] = {"kind": "operator", "prompt": "Release the brake", "answer": "yes", "brake": "release"}
STAGES: list[dict[str, Any]] = [
    RELEASE,
    {"kind": "spin", "speeds_rpm": [1000.0, -500.0], "turns": 3, "settle_s": 0.25},
    {"kind": "estimate"},
]
PLANT: dict[str, Any] = {"sensors": {"noise_a": 0.003}, "rotor": {"rest_angle_rad": 0.7}}


class TestSpin(StageConformance):
    def make_stage(self) -> Stage:
        return SpinStage()


def able(bench: Bench, **fields: Any) -> Capabilities:
    return bench.capabilities(**{"excitations": ALL, "watchdog_covers": ALL, "has_brake": True, **fields})


def planned(bench: Bench, capabilities: Capabilities, *stages: dict[str, Any]) -> list[Spin]:
    plan = make_plan(bench.procedure(*stages), capabilities)
    check_plan(plan, capabilities)
    return [p.excitation for p in plan.points if isinstance(p.excitation, Spin)]


def test_gates_off_comes_first_and_the_second_speed_s_points_lie_between_the_first_s(pm400: Bench) -> None:
    forward, backward, *driven = planned(pm400, able(pm400), RELEASE, {"kind": "spin"})
    assert (forward.bridge, backward.bridge) == ("off", "off")
    assert backward.speed_rad_s == pytest.approx(-0.5 * forward.speed_rad_s)
    one = {(e.current_d_a, e.current_q_a) for e in driven if e.speed_rad_s > 0}
    other = {(e.current_d_a, e.current_q_a) for e in driven if e.speed_rad_s < 0}
    assert (len(one), len(other)) == (25, 16)
    assert not one & other
    assert all(e.duration_s * abs(e.speed_rad_s) == pytest.approx(16.0 * math.pi) for e in driven)


@pytest.mark.parametrize(
    ("before", "settings", "message"),
    [
        ({"brake": "engage"}, {}, "stages.1: spin with the brake engaged; put a stage with brake: release before it"),
        ({}, {"speeds_rpm": [9000.0]}, "stages.1.speeds_rpm: spin has a back-EMF of 979.5 V between terminals"),
        ({}, {"speeds_rpm": [3000.0], "gates_off": False}, "stages.1.speeds_rpm: spin needs"),
        ({}, {"range_a": 9.0}, "stages.1.range_a: spin reaches"),
    ],
)
def test_what_cannot_be_is_refused_with_its_setting(
    pm400: Bench, before: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(CapabilityError) as refused:
        planned(pm400, able(pm400), {**RELEASE, **before}, {"kind": "spin", **settings})
    assert message in str(refused.value)


def test_a_drive_that_turns_no_rotor_is_refused_by_name(pm400: Bench) -> None:
    with pytest.raises(CapabilityError, match=r"the drive 'bench drive' has no spin; it has gates_off"):
        planned(pm400, pm400.capabilities(), RELEASE, {"kind": "spin"})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("spin")
    result = run_tiny(
        folder, stages=STAGES, drive={"plant": PLANT, "watchdog_s": 60.0}, limits={"current_a": 5.0, "voltage_v": 180.0}
    )
    assert result.outcome.ending == "finished"
    return folder / "run"


def test_the_terminals_have_the_magnets_voltage_with_the_gates_off(run: Path, tmp_path: Path) -> None:
    recording = open_recording(run)
    procedure = tiny_procedure(tmp_path, stages=STAGES)
    magnet = true_flux(SimulatedOptions(plant=PLANT), procedure.motor).pm_flux_wb
    for segment in recording.segments():
        if segment.settings["bridge"] == "off":
            capture = recording.load(segment)
            speed = segment.settings["speed_rad_s"]
            v = capture.v_ab @ np.array([1.0, 1j])
            np.testing.assert_allclose(np.abs(v), abs(speed) * magnet, rtol=1e-4)
            turned = np.unwrap(np.angle(v))
            rate = np.polyfit(np.arange(len(v)), turned, 1)[0] * recording.manifest.drive.sampling_frequency_hz
            assert rate == pytest.approx(speed, rel=1e-6)
            assert np.abs(capture.i_ab).max() < 0.02


def test_the_magnet_the_angle_and_the_resistance_are_reported(run: Path) -> None:
    remarks = {remark.code: remark for remark in estimated(run).remarks}
    assert remarks["spin.magnet_flux"].values["flux_wb"] == pytest.approx(0.3, rel=1e-3)
    assert remarks["spin.resistance_by_emf"].values["value_ohm"] == pytest.approx(4.25, rel=0.005)
    # The procedure has aligned nothing: it believes the rotor at 0 where it stands at 0.7 rad.
    assert remarks["spin.angle_offset"].values["angle_deg"] == pytest.approx(np.degrees(0.7), abs=0.1)


@pytest.mark.parametrize(("ratio", "message"), [(-1.0, "phase order"), (2.0, "0.5 times as many pole pairs")])
def test_no_current_is_held_in_a_frame_that_is_not_the_rotor_s(ratio: float, message: str, tmp_path: Path) -> None:
    plant = {**PLANT, "rotor": {"rest_angle_rad": 0.0, "encoder_ratio": ratio}}
    stages = [RELEASE, {"kind": "spin", "speeds_rpm": [1000.0], "turns": 3, "points_a": [[0.0, 1.0]]}]
    result = run_tiny(tmp_path, stages=stages, drive={"plant": plant})
    assert result.outcome.ending == "aborted"
    ended = next(m for m in messages_of(tmp_path / "run") if isinstance(m, RunEnded))
    assert message in ended.reason
    assert [s.id for s in open_recording(tmp_path / "run").segments()] == ["spin-000"]


def test_the_shipped_procedure_holds_the_turning_map_against_the_one_at_standstill() -> None:
    stages = [entry.kind for entry in load_procedure("spin").stages]
    assert stages.index("steps") < stages.index("spin") < stages.index("estimate")


@pytest.mark.slow
@pytest.mark.parametrize(("volts", "threshold_a"), [(0.3, 0.2), (1.0, 0.1), (3.0, 0.23), (3.0, 0.08)])
def test_what_is_stated_holds_behind_dead_time(volts: float, threshold_a: float, tmp_path: Path) -> None:
    """Its ripple in the current turns what each phase loses out of the current's direction."""
    dead_time = {"voltage_v": volts, "threshold_a": threshold_a}
    drive = {"plant": {"sensors": {"noise_a": 0.004}, "effects": {"dead_time": dead_time}}}
    stages = [RELEASE, {"kind": "spin", "speeds_rpm": [1000.0, -500.0], "turns": 4, "settle_s": 0.25}]
    stages += [{"kind": "estimate"}]
    result = run_tiny(tmp_path, stages=stages, drive=drive, limits={"current_a": 5.0, "voltage_v": 180.0})
    assert result.outcome.ending == "finished"
    run = tmp_path / "run"
    values = {remark.code: remark.values for remark in estimated(run).remarks}
    assert values["spin.inverter_loss"]["kept_v"] == pytest.approx(volts, rel=0.02)
    ohm, std = (values["spin.resistance_by_emf"][name] for name in ("value_ohm", "std_ohm"))
    assert isinstance(ohm, float)
    assert isinstance(std, float)
    assert abs(ohm - 4.25) < 2.0 * std
    off, stated = flux_errors(run, "spin")
    assert np.mean(np.abs(off) < 1.96 * stated) > 0.9
    assert errors_percent(run, "spin") < 0.05
