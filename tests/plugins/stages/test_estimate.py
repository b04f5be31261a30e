"""The estimate stage."""

from __future__ import annotations

from orchestrator.testing import StageConformance
from plugins.stages.estimate import EstimateStage
from protocols import PluginUse, Stage


class TestEstimate(StageConformance):
    def make_stage(self) -> Stage:
        return EstimateStage()


def test_all_installed_estimators_are_used_unless_some_are_named() -> None:
    assert list(EstimateStage().uses()) == [PluginUse("estimators", None), PluginUse("effects", None)]
    named = EstimateStage(estimators=("classical", "energy")).uses()
    assert [(use.name, use.field) for use in named] == [
        ("classical", "estimators.0"),
        ("energy", "estimators.1"),
        (None, named[-1].field),
    ]
