"""An effect rests on the moves that brought it, kept it or named it."""

from __future__ import annotations

from typing import Any

import pytest

from orchestrator.diagnosis import Criteria, explanation_of, model_changes, removed_effects
from orchestrator.diagnosis.fitting.progress import SearchRecorder
from orchestrator.diagnosis.reporting.convention import convention_report
from protocols import Convention, ManifestCorrection, ModelEffect, MotorModel
from tests.plugins.streams.report.example_diagnosis import a_diagnosis


def test_an_effect_rests_on_the_moves_that_brought_it_and_kept_it() -> None:
    recorder = SearchRecorder()
    recorder.record("screen", ["dead_time", "bus_sag"])
    recorder.record("add", ["dead_time"], taken=True)
    recorder.record("add", ["bus_sag"], taken=False)
    recorder.record("free_shape", ["dead_time"], taken=False)
    recorder.record("swap", ["device_drop", "dead_time"], taken=False)
    recorder.record("remove", ["dead_time"], taken=False)
    recorder.record("swap", ["bus_sag", "dead_time"], taken=True)
    recorder.record("remove", ["bus_sag"], taken=True)
    (basis,) = explanation_of(a_diagnosis(search=recorder.events)).effects
    assert basis.name == "dead_time"
    assert basis.steps == (2, 5, 6)
    assert basis.twins == ("device_drop",)


def test_a_convention_is_explained_by_its_evidence() -> None:
    convention = Convention(
        kind="scaled_currents",
        what="currents are effective values",
        evidence="all set-points are 1.414 times the readings",
        correction=ManifestCorrection(text="multiply the currents by 1.414"),
    )
    explanation = explanation_of(convention_report("r", convention, Criteria(), 1.0))
    assert [reason.sentence for reason in explanation.reasons] == [convention.evidence]
    assert explanation.verdict_record is None
    assert explanation.search == ()


def a_model(*effects: tuple[str, bool | None]) -> MotorModel:
    """A model with these effects, each with whether it helped when it was added."""
    plain: dict[str, Any] = {"parameters": {}, "relative_size": 1.0, "log_evidence": 1.0}
    fields: dict[str, Any] = {"effects": tuple(ModelEffect(name=name, helps=helps, **plain) for name, helps in effects)}
    return MotorModel.model_construct(**fields)


@pytest.mark.parametrize(
    ("model", "changes"),
    [
        (a_model(("dead_time", None)), ()),
        (a_model(("dead_time", None), ("bus_sag", False)), ("+ bus sag (does not help)",)),
        (a_model(("bus_sag", True)), ("+ bus sag", "− dead time")),
        (a_model(), ("− dead time",)),
    ],
)
def test_effects_that_were_added_and_removed_since_are_reported(model: MotorModel, changes: tuple[str, ...]) -> None:
    last = a_diagnosis().ladder[-1].model_copy(update={"effects": ("dead_time",)})
    report = a_diagnosis(ladder=[*a_diagnosis().ladder[:-1], last])
    assert explanation_of(report, model).model_changes == changes
    assert removed_effects(report, model) == ("dead_time",) * any(change.startswith("−") for change in changes)
    assert model_changes(a_diagnosis(), model) == ()  # an older file, which does not have the effects of its model
