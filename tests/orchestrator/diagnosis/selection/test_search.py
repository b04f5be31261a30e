"""The search names the effects that are present, and none in noise, whether few effects are missing or many."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.criteria import Criteria, SelectionCriteria
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, Library, scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.progress import Budget, SearchRecorder
from orchestrator.diagnosis.selection import search as search_module
from orchestrator.diagnosis.selection.adding import full_model
from orchestrator.diagnosis.selection.scoring import linear_view
from orchestrator.diagnosis.selection.search import best_first, result_of, search_effects
from orchestrator.diagnosis.selection.search_state import (
    AcceptedModel,
    InterimRecorder,
    Move,
    SearchResult,
    SearchState,
)
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.timing import VoltageDelay
from protocols import Effect, Signals
from tests.orchestrator.diagnosis.pieces import (
    Array,
    fitter,
    free_model,
    plan,
    prepared,
    setup_of,
    timer,
    with_voltage,
)
from tests.orchestrator.diagnosis.selection.states import state_of

BIAS_V = np.array([0.3, -0.1])


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), BIAS_V))


def _searched(maker: Fitter, library: Library) -> SearchResult:
    """What a search finds, where the part is the whole recording."""
    steps = [AcceptedModel(None, maker.fit(free_model()))]
    return search_effects(setup_of(maker), steps, library, InterimRecorder())[1]


def test_the_search_names_what_is_there_and_nothing_beside_it(biased: Fitter) -> None:
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], biased.prepared.manifest)
    search = _searched(biased, library)
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.fit.chi2_per_dof == pytest.approx(1.0, abs=0.2)


def test_what_is_redundant_goes_although_the_budget_is_spent(biased: Fitter) -> None:
    maker = replace(biased, budget=Budget(limit=0.0, spent=1.0), trace=SearchRecorder())
    library = scaled_library([VoltageBias(), DeadTime(), VoltageDelay()], maker.prepared.manifest)
    both = free_model().with_active([c.absent() for c in library[:2]])
    state = state_of(maker, maker.fit(both))
    found = best_first(state, [AcceptedModel(None, state.fit)], library, InterimRecorder())
    assert found.fit.model.names == ("voltage_bias",)
    assert {event.move for event in maker.trace.events} == {"screen", "remove"}


def test_noise_alone_is_given_no_name() -> None:
    maker = fitter(prepared(plan(sparse=True), seed=3))
    search = _searched(maker, scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], maker.prepared.manifest))
    assert [step.added for step in search.steps] == [None]
    assert search.detected_not_named == []
    assert {(event.move, event.decision) for event in maker.trace.events} == {("screen", "rejected")}
    for event in maker.trace.events:
        assert event.score is not None
        assert event.threshold is not None
        assert event.score < event.threshold


@pytest.mark.parametrize(("is_part", "first"), [(True, "finer_map"), (False, "add")])
def test_a_finer_map_competes_with_the_first_effects_of_a_part(
    biased: Fitter, is_part: bool, first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = state_of(biased)
    library = scaled_library([VoltageBias(), DeadTime()], biased.prepared.manifest)
    state = replace(state, view=linear_view(biased, state.fit, library), is_part=is_part)
    gain = 0.6 * (state.fit.chi2 - state.fit.dof)
    monkeypatch.setattr(search_module, "add_moves", lambda *_: [Move("add", ("voltage_bias",), lambda: None, gain)])
    monkeypatch.setattr(search_module, "gain_of_all", lambda _: gain)
    assert next(iter(search_module._moves(state, library))).kind == first


def test_every_refit_is_on_record_with_the_score_that_decided(biased: Fitter) -> None:
    maker = replace(biased, trace=SearchRecorder())
    _searched(maker, scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], maker.prepared.manifest))
    refits = [event for event in maker.trace.events if event.move == "refit"]
    (added,) = [event for event in maker.trace.events if event.move == "add"]
    assert (added.effects, added.decision) == (("voltage_bias",), "accepted")
    assert added.score == max(event.score or 0.0 for event in refits)
    assert added.threshold == maker.prepared.criteria.selection.log_evidence
    assert maker.trace.events[-1].decision == "rejected"


def test_thresholds_are_those_that_are_handed_in(biased: Fitter) -> None:
    strict = Criteria(selection=SelectionCriteria(log_evidence=1e9))
    maker = replace(biased, prepared=replace(biased.prepared, criteria=strict))
    assert len(_searched(maker, scaled_library([VoltageBias()], maker.prepared.manifest)).steps) == 1


@pytest.mark.slow
def test_an_effect_that_explains_more_comes_before_the_form_of_the_newest_one() -> None:
    recording = prepared(plan())
    error = {p.segment.id: _knee_and_bias(p.signals) for p in recording.pieces}
    maker = replace(fitter(with_voltage(recording, error)), trace=SearchRecorder())
    search = _searched(maker, scaled_library([DeadTime(), VoltageBias()], recording.manifest))
    assert set(search.fit.model.names) == {"dead_time", "voltage_bias"}
    assert search.fit.chi2_per_dof == pytest.approx(1.0, abs=0.2)
    taken = [event.move for event in maker.trace.events if event.decision == "accepted"]
    assert taken[:3] == ["add", "add", "free_shape"]


def _knee_and_bias(signals: Signals) -> Array:
    """What the command has on top for a dead time of 0.5 V with a sharp knee, and a bias nearly as large."""
    dead_time = DeadTime()
    left = dead_time.correct(signals, dead_time.Parameters(voltage_v=0.5, softness=0.3)).v_ab
    assert left is not None
    return np.asarray(signals.v_ab - left + np.array([0.3, -0.2]), dtype=np.float64)


@pytest.fixture(scope="module")
def library(biased: Fitter) -> tuple[CandidateEffect, ...]:
    effects: list[Effect] = [DeadTime(), RotorMisalignment(), VoltageBias(), PhaseResistanceImbalance()]
    return scaled_library(effects, biased.prepared.manifest)


def _from_all(maker: Fitter, library: Library) -> SearchState:
    """The state that a search reaches from all effects of the library."""
    state = full_model(state_of(maker), library)
    assert state.is_joint
    return best_first(state, [AcceptedModel(None, maker.fit(free_model()))], library, InterimRecorder())


@pytest.mark.slow
def test_from_all_effects_what_is_there_stays_and_what_is_not_goes(
    biased: Fitter, library: tuple[CandidateEffect, ...]
) -> None:
    fit = _from_all(biased, library).fit
    assert fit.model.names == ("voltage_bias",)
    assert fit.model.active[0].values["bias_a_v"] == pytest.approx(BIAS_V[0], rel=0.02)
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / fit.dof))
    again = _from_all(biased, library[::-1]).fit
    assert again.model.names == fit.model.names
    assert again.objective == pytest.approx(fit.objective, rel=1e-3)


def test_from_all_effects_nothing_stays_where_nothing_is_hidden(library: tuple[CandidateEffect, ...]) -> None:
    clean = fitter(prepared(plan(sparse=True)))
    state = _from_all(clean, library)
    assert state.fit.model.names == ()
    assert state.indistinguishable == {}
    search = result_of(replace(state, is_part=False), [AcceptedModel(None, state.fit)])
    assert ([step.added for step in search.steps], search.doubtful) == ([None], ())


def test_a_timer_that_leaves_more_than_none_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = setup_of(fitter(with_voltage(prepared(plan(), noise_a=0.002), np.array([0.05, 0.0]))))
    steps = [AcceptedModel(None, setup.fitter.fit(free_model()))]
    assert steps[0].fit.chi2_per_dof > 1.08
    for step_s, is_one in ((2e-6, False), (1e-12, True)):
        given = timer(step_s, 0.3, 0.6)
        monkeypatch.setattr(
            search_module, "with_detected_quantiser", lambda setup, *_, given=given: setup.with_quantiser(given)
        )
        timed, _ = search_effects(setup, steps, [], InterimRecorder())
        assert (timed.prepared.quantiser is not None) == is_one
