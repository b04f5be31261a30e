"""The operator stage."""

from __future__ import annotations

from orchestrator.testing import StageConformance
from plugins.stages.operator import OperatorStage
from protocols import Stage


class TestOperator(StageConformance):
    def make_stage(self) -> Stage:
        return OperatorStage(prompt="Release the brake.")
