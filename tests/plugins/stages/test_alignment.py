"""The alignment stage: the angle that is believed from then on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from orchestrator.testing import StageConformance
from plugins.drives.simulated import SimulatedOptions
from plugins.drives.simulated._state import THETA
from plugins.drives.simulated.rig import Rig
from plugins.stages.alignment import AlignmentStage
from protocols import Limits, Motor, Segment, SegmentStage, Stage, StageRun
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

    def set_brake(self, engaged: bool) -> None:
        self.moved.append(engaged)
        self.rig.set_brake(engaged)


def angle_after_alignment(pm400: Bench, stage: dict[str, Any], offset_a: float) -> tuple[float, list[bool]]:
    """Electrical angle of a free rotor after alignment and the way down [deg], and how the brake was moved."""
    plant = {"effects": {"current_offset": {"offset_b_a": offset_a}}, "brake": {"start": "released"}}
    options = SimulatedOptions.model_validate({"dc_bus_voltage_v": pm400.bus_v, "plant": plant})
    rig = Rig(options, Motor.model_validate(pm400.motor), 3)
    rig.limit(Limits.model_validate(pm400.limits))
    (point,) = plan_of(pm400, {"kind": "alignment", **stage}).points
    for _ in rig.excite(point.excitation, 1 << 60):
        pass
    run = Run(rig)
    segment = Segment(id="alignment-000", stage=SegmentStage.ALIGNMENT, start_s=0.0, samples=1)
    AlignmentStage.model_validate(stage).after_point(cast(StageRun, run), segment)
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


def test_without_an_offset_the_brake_makes_no_difference(pm400: Bench) -> None:
    held, _ = angle_after_alignment(pm400, {"brake": "engage"}, 0.0)
    turned, _ = angle_after_alignment(pm400, {}, 0.0)
    assert held == pytest.approx(turned, abs=0.1)
