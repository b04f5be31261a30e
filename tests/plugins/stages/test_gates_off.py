"""The gates-off stage."""

from __future__ import annotations

from orchestrator.testing import StageConformance
from plugins.stages.gates_off import GatesOffStage
from protocols import Stage


class TestGatesOff(StageConformance):
    def make_stage(self) -> Stage:
        return GatesOffStage()
