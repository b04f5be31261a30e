"""The alignment stage: the angle that is believed from then on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Literal, cast

import numpy as np
import pytest

from orchestrator.config import PlannedPoint
from orchestrator.testing import StageConformance
from plugins.drives.simulated import SimulatedOptions, map_motor
from plugins.drives.simulated._state import THETA
from plugins.drives.simulated.rig import Rig
from plugins.stages.alignment import AlignmentStage
from protocols import (
    Capture,
    DriveRecord,
    Hold,
    Limits,
    Manifest,
    Motor,
    Note,
    Procedure,
    Segment,
    SegmentStage,
    Stage,
    StageRun,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.support.benches import Bench, plan_of


class TestAlignment(StageConformance):
    def make_stage(self) -> Stage:
        return AlignmentStage()


def test_the_believed_angle_is_that_of_the_last_alignment(pm400: Bench) -> None:
    stages: list[dict[str, Any]] = [
        {"kind": "resistance", "anchor": True},
        {"kind": "alignment", "angle_rad": 0.5},
        {"kind": "gates_off"},
        {"kind": "resistance", "anchor": True},
        {"kind": "alignment", "angle_rad": -1.0},
        {"kind": "injection", "anchor": True},
    ]
    assert [p.excitation.rotor_angle_rad for p in plan_of(pm400, *stages).points] == [0.0, 0.5, 0.5, 0.5, -1.0, -1.0]


@dataclass
class Run:
    """What the stage may do with the brake, done to a rig whose current still flows."""

    rig: Rig
    moved: list[bool] = field(default_factory=list)
    read: MemoryRecording | None = None
    procedure: Procedure | None = None
    has_brake: bool = True
    notes: list[str] = field(default_factory=list)

    @property
    def capabilities(self) -> SimpleNamespace:
        return SimpleNamespace(has_brake=self.has_brake)

    def publish(self, message: Note) -> None:
        self.notes.append(message.text)

    def recording(self) -> MemoryRecording:
        assert self.read is not None
        return self.read

    def set_brake(self, engaged: bool) -> None:
        self.moved.append(engaged)
        self.rig.set_brake(engaged)


def angle_after_alignment(
    pm400: Bench, stage: dict[str, Any], offset_a: float, *, known: bool = False
) -> tuple[float, list[bool]]:
    """Electrical angle of a free rotor after alignment and the way down [deg], and how the brake was moved."""
    plant = {"effects": {"current_offset": {"offset_b_a": offset_a}}, "brake": {"start": "released"}}
    options = SimulatedOptions.model_validate({"dc_bus_voltage_v": pm400.bus_v, "plant": plant})
    rig = Rig(options, Motor.model_validate(pm400.motor), 3)
    rig.limit(Limits.model_validate(pm400.limits))
    (point,) = plan_of(pm400, {"kind": "alignment", **stage}).points
    readings = [(0.0, 2.0 / math.sqrt(3.0) * offset_a)] if known else []
    run = Run(rig, read=read_without_current(pm400, *readings), procedure=pm400.procedure({"kind": "alignment"}))
    filled = AlignmentStage.model_validate({**stage, "current_a": point.excitation.longest_current_a})
    (excitation,) = filled.as_run(cast(StageRun, run), [point.excitation])
    for _ in rig.excite(excitation, 1 << 60):
        pass
    segment = Segment(id="alignment-000", stage=SegmentStage.ALIGNMENT, start_s=0.0, samples=1)
    filled.after_point(cast(StageRun, run), segment)
    for _ in rig.to_zero(1 << 60):
        pass
    rig.drain()
    rig.set_brake(True)
    angle = float(rig.simulator.memory.state[THETA])
    return math.degrees(math.remainder(angle, 2 * math.pi)), run.moved


def test_a_rotor_that_is_braked_under_current_stays_where_it_was_aligned(pm400: Bench) -> None:
    held, moved = angle_after_alignment(pm400, {"brake": "engage"}, 0.021)
    assert moved == [True]
    # The offset's share of the alignment's current is all that is left, and a little friction.
    assert abs(held) == pytest.approx(math.degrees(2 / math.sqrt(3) * 0.021 / 2.348), abs=0.05)
    turned, moved = angle_after_alignment(pm400, {}, 0.021)
    assert moved == []
    assert abs(turned) > 4 * abs(held)


def test_an_offset_that_was_read_before_does_not_turn_the_rotor(pm400: Bench) -> None:
    unknown, _ = angle_after_alignment(pm400, {"brake": "engage"}, 0.05)
    known, _ = angle_after_alignment(pm400, {"brake": "engage"}, 0.05, known=True)
    assert abs(unknown) > 1.0
    assert abs(known) < 0.1


def test_without_an_offset_the_brake_makes_no_difference(pm400: Bench) -> None:
    held, _ = angle_after_alignment(pm400, {"brake": "engage"}, 0.0)
    turned, _ = angle_after_alignment(pm400, {}, 0.0)
    assert held == pytest.approx(turned, abs=0.1)


def read_without_current(pm400: Bench, *readings: tuple[float, float]) -> MemoryRecording:
    """A recording of what the sensors say with the gates off, (alpha, beta) in each segment [A]."""
    names = [f"gates_off-{k:03d}" for k in range(len(readings))]
    segments = [
        Segment(id=name, stage=SegmentStage.GATES_OFF, start_s=float(k), samples=50) for k, name in enumerate(names)
    ]
    captures = {
        name: Capture(
            start_s=float(k),
            sampling_frequency_hz=1e4,
            i_ab=np.tile(np.array(reading, np.float32), (50, 1)),
            v_ab=np.zeros((50, 2), np.float32),
            v_dc=np.full(50, 540.0, np.float32),
        )
        for k, (name, reading) in enumerate(zip(names, readings, strict=True))
    }
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="so far",
        created="2026-01-01T00:00:00Z",
        motor=Motor.model_validate(pm400.motor),
        drive=DriveRecord(name="d", sampling_frequency_hz=1e4, dc_bus_voltage_v=540.0),
        segments=tuple(segments),
    )
    return MemoryRecording(manifest, captures)


def chosen_point(pm400: Bench, *readings: tuple[float, float]) -> PlannedPoint:
    """The alignment's point at 90 degrees, as it is run after these readings."""
    (point,) = plan_of(pm400, {"kind": "alignment", "angle_rad": math.pi / 2, "current_a": 2.0}).points
    stage = AlignmentStage(angle_rad=math.pi / 2, current_a=2.0)
    read, procedure = read_without_current(pm400, *readings), pm400.procedure({"kind": "alignment"})
    run = cast(StageRun, Run(cast(Rig, None), [], read, procedure))
    (excitation,) = stage.as_run(run, [point.excitation])
    return point.run_as(excitation)


@pytest.mark.parametrize(
    ("reading_a", "brake", "has_brake", "warned"),
    [(0.02, None, True, True), (0.02, "engage", False, True), (0.02, "engage", True, False), (1e-4, None, True, False)],
)
def test_an_offset_that_will_turn_the_rotor_on_the_way_down_is_reported(
    pm400: Bench, reading_a: float, brake: Literal["engage"] | None, has_brake: bool, warned: bool
) -> None:
    rig = Rig(SimulatedOptions(dc_bus_voltage_v=pm400.bus_v), Motor.model_validate(pm400.motor), 3)
    run = Run(rig, read=read_without_current(pm400, (reading_a, 0.0)), has_brake=has_brake)
    segment = Segment(id="alignment-000", stage=SegmentStage.ALIGNMENT, start_s=0.0, samples=1)
    AlignmentStage(current_a=2.0, brake=brake).after_point(cast(StageRun, run), segment)
    assert bool(run.notes) == warned
    assert all("turns a rotor which is free" in text for text in run.notes)


def test_what_the_sensors_read_without_current_is_added_in_the_rotors_frame(pm400: Bench) -> None:
    point = chosen_point(pm400, (0.5, 0.5), (0.02, 0.05))
    assert isinstance(point.excitation, Hold)
    assert (point.excitation.current_d_a, point.excitation.current_q_a) == pytest.approx((2.05, -0.02))
    assert (point.settings["current_d_a"], point.settings["current_q_a"]) == pytest.approx((2.05, -0.02))
    assert point.excitation.rotor_angle_rad == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("readings", [[], [(0.3, 0.0)], [(0.0, 1.0)]])
def test_nothing_is_added_without_a_reading_or_to_one_that_is_no_offset(
    pm400: Bench, readings: list[tuple[float, float]]
) -> None:
    point = chosen_point(pm400, *readings)
    assert point.settings == {"current_d_a": 2.0, "current_q_a": 0.0}


BALDOR = map_motor("baldor-5k6").model_dump(exclude_none=True)
"""Its L_q - L_d outweighs the magnet from 3.5 A on, of a rated current of 12.4 A."""


def rest_of_a_salient_rotor(current_a: float | None) -> tuple[float, float]:
    """Where the alignment's current leaves the d axis of a free rotor [deg], and that current."""
    bench = Bench(BALDOR, {"current_a": 18.0, "voltage_v": 380.0}, 800.0)
    plant = {"magnetics": {"kind": "map", "name": "baldor-5k6"}, "brake": {"start": "released"}}
    options = SimulatedOptions.model_validate({"dc_bus_voltage_v": bench.bus_v, "plant": plant})
    rig = Rig(options, Motor.model_validate(bench.motor), 3)
    rig.limit(Limits.model_validate(bench.limits))
    (point,) = plan_of(bench, {"kind": "alignment", "current_a": current_a, "settle_s": 2.0}).points
    for _ in rig.excite(point.excitation, 1 << 60):
        pass
    angle = float(rig.simulator.memory.state[THETA])
    return math.degrees(math.remainder(angle, 2 * math.pi)), point.excitation.longest_current_a


def test_a_rotor_with_more_saliency_than_magnet_rests_with_its_d_axis_on_the_current() -> None:
    angle, current = rest_of_a_salient_rotor(None)
    assert current == pytest.approx(0.5 * 0.4442 / (0.151 - 0.0238), rel=0.05)
    assert abs(angle) < 1.0
    away, _ = rest_of_a_salient_rotor(12.4)
    assert abs(away) > 20.0


def test_a_current_under_which_the_d_axis_is_no_place_of_rest_is_reported() -> None:
    bench = Bench(BALDOR, {"current_a": 18.0, "voltage_v": 380.0}, 800.0)
    (note,) = plan_of(bench, {"kind": "alignment", "current_a": 12.4}).notes
    assert "from 3.49 A on" in note
    assert "1.75 A hold it best" in note
    assert not plan_of(bench, {"kind": "alignment", "current_a": 3.4}).notes
