"""The alignment stage: the angle that is believed from then on."""

from __future__ import annotations

from typing import Any

from orchestrator.testing import StageConformance
from plugins.stages.alignment import AlignmentStage
from protocols import Stage
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
