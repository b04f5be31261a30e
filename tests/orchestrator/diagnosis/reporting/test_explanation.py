"""An effect rests on the moves that brought it, kept it or named it."""

from __future__ import annotations

from orchestrator.diagnosis import Criteria, explanation_of
from orchestrator.diagnosis.reporting.convention import convention_report
from orchestrator.diagnosis.search_recorder import SearchRecorder
from protocols import Convention, ManifestCorrection
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
