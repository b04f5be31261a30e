"""The resistance stage: which currents."""

from __future__ import annotations

from itertools import pairwise

from orchestrator.testing import StageConformance
from plugins.stages.resistance import ResistanceStage
from protocols import Stage
from tests.support.benches import Bench, plan_of, targets


class TestResistance(StageConformance):
    def make_stage(self) -> Stage:
        return ResistanceStage()


def test_default_resistance_points_are_denser_near_zero(pm400: Bench) -> None:
    on_d = sorted(d for d, q in targets(plan_of(pm400, {"kind": "resistance"})) if q == 0 and d > 0)
    gaps = [b - a for a, b in pairwise(on_d)]
    assert gaps == sorted(gaps)
    assert on_d[0] < 0.05 * on_d[-1]
