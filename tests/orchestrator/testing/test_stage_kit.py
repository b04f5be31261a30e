"""The stage kit passes a stage that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import pytest
from pydantic import ConfigDict

from orchestrator.stages import Scaling, given
from orchestrator.testing import StageConformance
from protocols import (
    EnergisedStage,
    Hold,
    PluginUse,
    Positive,
    SegmentStage,
    Stage,
    StageContext,
    StagePoint,
    StageState,
)
from tests.orchestrator.testing.kit_runner import failures


class ExampleStage(EnergisedStage):
    """Holds the rated current once."""

    name = "example"
    title = "example"
    measuring = StageState("holding", "hold")
    records_as: ClassVar[SegmentStage | None] = SegmentStage.RESISTANCE

    current_a: Positive | None = None

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        current = self.current_a
        if current is None:
            current = scaling.within_limit_a(scaling.rated_current_a("current_a"))
        return self.model_copy(update={"current_a": current, "control": scaling.control(self.control)})

    def points(self) -> Iterable[StagePoint]:
        yield StagePoint(Hold(current_d_a=given(self.current_a), current_q_a=0.0, settle_s=0.1, duration_s=0.5))


def kit_for(stage: type[Stage]) -> StageConformance:
    class Kit(StageConformance):
        registered = False

        def make_stage(self) -> Stage:
            return stage()

    return Kit()


def test_passes_a_stage_that_keeps_the_contract(tmp_path: Path) -> None:
    assert failures(kit_for(ExampleStage), tmp_path) == {}


class NoTitle(ExampleStage):
    title = " "


class MeasuresNothing(ExampleStage):
    def points(self) -> Iterable[StagePoint]:
        return ()


class RecordsAsNothing(ExampleStage):
    records_as = None


class HasTheRunsState(ExampleStage):
    measuring = StageState("stopping", "hold")


class ForgetsWhatIsWritten(ExampleStage):
    current_a: Positive | None = 1.0

    def filled(self, context: StageContext) -> Self:
        return self.model_copy(update={"current_a": 2.0})


class FillsInTwice(ExampleStage):
    gain: Positive = 1.0

    def filled(self, context: StageContext) -> Self:
        return super().filled(context).model_copy(update={"gain": 2.0 * self.gain})


class DrawsLots(ExampleStage):
    def points(self) -> Iterable[StagePoint]:
        current = random.random()
        yield StagePoint(Hold(current_d_a=current, current_q_a=0.0, settle_s=0.1, duration_s=0.5))


class TakesAnything(ExampleStage):
    model_config = ConfigDict(extra="allow", frozen=True)


class CanBeChanged(ExampleStage):
    model_config = ConfigDict(frozen=False)


class ForgetsWhichSetting(ExampleStage):
    def filled(self, context: StageContext) -> Self:
        rated = context.procedure.motor.rated_current_a
        if rated is None:
            raise Scaling(context).error("current_a", "no rated current")
        return super().filled(context)


class UsesWhatNobodyNames(ExampleStage):
    def uses(self) -> Sequence[PluginUse]:
        return (PluginUse("estimators", "energy", "estimators.0"),)


class SettingsThatAreNoJson(ExampleStage):
    def points(self) -> Iterable[StagePoint]:
        for point in super().points():
            settings: dict[str, Any] = {"when": object()}
            yield StagePoint(point.excitation, settings)


MUTATIONS: list[tuple[type[Stage], str]] = [
    (NoTitle, "class_keeps_the_contract"),
    (RecordsAsNothing, "class_keeps_the_contract"),
    (HasTheRunsState, "states_are"),
    (MeasuresNothing, "points_are_there"),
    (SettingsThatAreNoJson, "points_are_there"),
    (ForgetsWhatIsWritten, "filling_in_leaves"),
    (FillsInTwice, "not_filled_again"),
    (DrawsLots, "same_points"),
    (TakesAnything, "unknown_setting"),
    (CanBeChanged, "cannot_be_changed"),
    (ForgetsWhichSetting, "bare_nameplate"),
    (UsesWhatNobodyNames, "plugins_that_it_uses"),
]


@pytest.mark.parametrize(("stage", "check"), MUTATIONS, ids=[f"{s.__name__}-{c}" for s, c in MUTATIONS])
def test_fails_a_stage_that_breaks_the_contract(tmp_path: Path, stage: type[Stage], check: str) -> None:
    assert failures(kit_for(stage), tmp_path, only=check), f"{stage.__name__} passes {check}"
