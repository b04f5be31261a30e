"""The search names what is there, and nothing in noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.criteria import Criteria, SelectionCriteria
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.search_recorder import SearchRecorder
from orchestrator.diagnosis.selection import forward_search as forward_search_module
from orchestrator.diagnosis.selection.search_result import AcceptedModel, forward
from orchestrator.diagnosis.selection.refining import extend_newest
from orchestrator.diagnosis.selection.scoring import linear_view
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.timing import VoltageDelay
from protocols import Signals
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.1, -0.05])))


def test_the_search_names_what_is_there_and_nothing_beside_it(biased: Fitter) -> None:
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], biased.prepared.manifest)
    search = forward(biased, [AcceptedModel(None, biased.fit(free_model()))], library)
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.fit.chi2_per_dof == pytest.approx(1.0, abs=0.2)


def test_noise_alone_is_given_no_name() -> None:
    maker = fitter(prepared(plan(sparse=True), seed=3))
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], maker.prepared.manifest)
    search = forward(maker, [AcceptedModel(None, maker.fit(free_model()))], library)
    assert [step.added for step in search.steps] == [None]
    assert search.detected_not_named == []
    (screen,) = maker.trace.events
    assert (screen.move, screen.decision) == ("screen", "refused")
    assert screen.score is not None
    assert screen.threshold is not None
    assert screen.score < screen.threshold


def test_every_refit_is_on_record_with_the_score_that_decided(biased: Fitter) -> None:
    maker = replace(biased, trace=SearchRecorder())
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], maker.prepared.manifest)
    search = forward(maker, [AcceptedModel(None, maker.fit(free_model()))], library)
    refits = [event for event in maker.trace.events if event.move == "refit"]
    (added,) = [event for event in maker.trace.events if event.move == "add"]
    assert added.effects == ("voltage_bias",)
    assert added.decision == "taken"
    assert added.score == search.steps[1].log_evidence == max(event.score or 0.0 for event in refits)
    assert added.threshold == maker.prepared.criteria.selection.log_evidence
    assert added.chi2_after == search.fit.chi2_per_dof
    assert maker.trace.events[-1].decision == "refused"


def test_thresholds_are_those_that_are_handed_in(biased: Fitter) -> None:
    strict = Criteria(selection=SelectionCriteria(log_evidence=1e9))
    maker = replace(biased, prepared=replace(biased.prepared, criteria=strict))
    search = forward(
        maker, [AcceptedModel(None, maker.fit(free_model()))], scaled_library([VoltageBias()], maker.prepared.manifest)
    )
    assert len(search.steps) == 1


def test_an_effect_that_explains_more_is_let_in_before_the_newest_one_is_bent(monkeypatch: pytest.MonkeyPatch) -> None:
    made = prepared(plan())
    error = {p.segment.id: _knee_and_bias(p.signals) for p in made.pieces}
    maker = fitter(with_voltage(made, error))
    library = scaled_library([DeadTime(), VoltageBias()], made.manifest)
    bent: list[tuple[str, ...]] = []

    def noted(maker: Fitter, fit: Fit, inflation: float) -> Fit:
        bent.append(fit.model.names)
        return extend_newest(maker, fit, inflation)

    monkeypatch.setattr(forward_search_module, "extend_newest", noted)
    search = forward(maker, [AcceptedModel(None, maker.fit(free_model()))], library)
    assert set(search.fit.model.names) == {"dead_time", "voltage_bias"}
    assert search.fit.chi2_per_dof == pytest.approx(1.0, abs=0.2)
    # What came first was bent with the other one there, not alone.
    assert all(len(names) == 2 for names in bent)
    assert not search.has_deferred_refinements


def test_what_waited_for_another_effect_is_bent_where_none_comes(biased: Fitter) -> None:
    library = scaled_library([VoltageBias()], biased.prepared.manifest)
    bare = biased.fit(free_model())
    search = forward(biased, [AcceptedModel(None, bare)], library)
    search.has_deferred_refinements = True
    assert forward_search_module._free_deferred(biased, search)
    assert not forward_search_module._free_deferred(biased, search)


def test_what_the_recording_cannot_separate_from_a_present_effect_keeps_no_refinement_waiting(
    biased: Fitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = scaled_library([DeadTime(), DeviceDrop()], biased.prepared.manifest)
    view = linear_view(biased, biased.fit(free_model()), library)
    monkeypatch.setattr(forward_search_module, "MIN_SHARE_BEFORE_REFINEMENTS", 0.0)
    monkeypatch.setattr(forward_search_module, "refinement_gain", lambda _: 0.0)
    assert forward_search_module._outweighs_refinements(view, set())
    assert forward_search_module._outweighs_refinements(view, {"dead_time"})
    assert not forward_search_module._outweighs_refinements(view, {"dead_time", "device_drop"})


def _knee_and_bias(signals: Signals) -> Array:
    """What the command has on top for a dead time of 0.5 V with a sharp knee, and a bias nearly as large."""
    dead_time = DeadTime()
    left = dead_time.correct(signals, dead_time.Parameters(voltage_v=0.5, softness=0.3)).v_ab
    assert left is not None
    return np.asarray(signals.v_ab - left + np.array([0.3, -0.2]), dtype=np.float64)
