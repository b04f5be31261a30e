"""Which effects of a final model are causes, and where a joint fit disagrees with the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection import naming
from orchestrator.diagnosis.selection.naming import build_ladder, drop_confounded, other_opinion, plain_ladder
from orchestrator.diagnosis.selection.scoring import log_bayes_factors
from orchestrator.diagnosis.selection.search_state import AcceptedModel, SearchResult, SearchState
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from plugins.effects.inverter import VoltageBias
from plugins.effects.iron import EddyCurrents
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentGainMismatch
from protocols import Effect, FoundEffect, JointEntry
from tests.orchestrator.diagnosis import pieces as made_of
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import free_model, plan, prepared
from tests.support.cases import few


def _fitted(bias_v: float, looked_for: Sequence[Effect]) -> tuple[DiagnosisSetup, Fit, Fit]:
    """A biased voltage and unequal gains, and fits without effects and with those that are looked for."""
    made = prepared(plan(sparse=True))
    maker = setup_of(made, sensor_noise(made.pieces)).fitter
    given = ((VoltageBias(), {"bias_a_v": bias_v}), (CurrentGainMismatch(), {"gain_a_minus_b": 0.005}))
    hidden = [with_free(free_model(), maker, effect, **values).active[0] for effect, values in given]
    setup = setup_of(made_of.with_effects(made, hidden), maker.noise)
    bare = setup.fitter.fit(free_model())
    absent = [c.absent() for c in scaled_library(looked_for, made.manifest)]
    return setup, bare, setup.fitter.fit(bare.model.with_active(absent))


def _ladder(setup: DiagnosisSetup, bare: Fit, whole: Fit) -> SearchResult:
    """The ladder of a joint model."""
    state = SearchState(setup, whole, bare.chi2_per_dof, is_part=False, is_joint=True)
    return build_ladder(state, [AcceptedModel(None, bare)])


def test_effects_that_were_added_one_by_one_are_causes_in_their_order() -> None:
    setup, bare, whole = _fitted(0.02, [VoltageBias(), CurrentGainMismatch()])
    tied = {"voltage_bias": ("current_offset",), "dead_time": ("device_drop",)}
    gains = {"voltage_bias": 50.0, "current_gain_mismatch": 20.0}
    state = SearchState(setup, whole, bare.chi2_per_dof, is_part=False, indistinguishable=tied, gains=gains)
    search = plain_ladder(replace(state, refused=("hysteresis", "voltage_bias")), [AcceptedModel(None, bare)])
    assert [step.added for step in search.steps] == [None, "voltage_bias", "current_gain_mismatch"]
    assert [step.log_evidence for step in search.steps] == [0.0, 50.0, 20.0]
    assert [step.fit for step in search.steps][::2] == [bare, whole]
    assert bare.chi2 > search.steps[1].fit.chi2 > whole.chi2
    assert search.indistinguishable == {"voltage_bias": ["current_offset"]}
    assert search.detected_not_named == ["hysteresis"]
    assert search.contributions == {}


def test_what_takes_away_about_as_much_as_is_left_is_no_cause() -> None:
    """A biased voltage, and gains that are not searched: another resistance in a phase takes some of what they do."""
    setup, bare, whole = _fitted(0.2, [VoltageBias(), PhaseResistanceImbalance()])
    search = _ladder(setup, bare, whole)
    assert search.contributions["phase_resistance_imbalance"].relative_to_error > whole.criteria.selection.named_share
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.below_materiality == ("phase_resistance_imbalance",)


@pytest.mark.parametrize(("bias_v", "is_cause"), [(0.0005, False), (0.003, True)])
def test_an_effect_beside_one_that_explains_the_recording_alone_is_no_cause(bias_v: float, is_cause: bool) -> None:
    setup, bare, whole = _fitted(bias_v, [VoltageBias(), CurrentGainMismatch()])
    joint = _ladder(setup, bare, whole)
    one_by_one = SearchState(setup, whole, bare.chi2_per_dof, is_part=False, gains=log_bayes_factors(whole))
    for search in (joint, plain_ladder(one_by_one, [AcceptedModel(None, bare)])):
        left = {step.added for step in search.steps} - {None}
        assert left == ({"voltage_bias", "current_gain_mismatch"} if is_cause else {"current_gain_mismatch"})
        assert set(search.fit.model.names) == left
        assert ("voltage_bias" in search.detected_not_named) is not is_cause


def test_what_takes_away_less_than_is_left_is_no_cause_however_large_its_share() -> None:
    """Another form's error is left: what an effect takes of it, and others could take as well, may be that form's."""
    setup, bare, whole = _fitted(0.02, [VoltageBias(), CurrentGainMismatch()])
    lesser, larger = sorted(log_bayes_factors(whole), key=lambda name: log_bayes_factors(whole)[name])
    unnamed = []
    for left in np.geomspace(0.01, 1000.0, 12):
        unnamed.append(set(_ladder(setup, bare, replace(whole, chi2=(1.0 + left) * whole.dof)).below_materiality))
    # The more is left, the fewer are certain, and the one that takes away more is so for as long or longer.
    assert unnamed[0] == set()
    assert unnamed[-1] == {lesser, larger}
    assert {larger} not in unnamed
    assert all(one <= next_one for one, next_one in pairwise(unnamed))


@pytest.mark.parametrize(("left", "named"), [(0.1, True), (0.4, False)])
def test_what_drifts_by_more_than_is_left_disagrees_on_something_else(
    left: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = _ladder(setup, bare, whole)
    monkeypatch.setattr(naming, "fitted_verdict", lambda *_: "unknown_remains")
    monkeypatch.setattr(naming, "residual_fraction_of", lambda *_: left)
    monkeypatch.setattr(naming, "block_scatter_ratio", lambda fit: dict.fromkeys(fit.model.names, 0.3))
    after = drop_confounded(setup.fitter, search)
    assert ("voltage_bias" in after.doubtful) != named
    assert ("voltage_bias" in [step.added for step in after.steps]) == named
    assert set(after.fit.model.names) == set(whole.model.names)


@few(
    "taken, by_another, named",
    [(3.0, 0.5, True), (3.0, 1.5, True), (30.0, 0.5, False), (3.0, 2.5, False)],
    fast=2,
)
def test_what_takes_away_many_times_the_whole_error_or_twice_it_beside_another_is_balanced_and_no_cause(
    taken: float, by_another: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = _ladder(setup, bare, whole)
    sizes = {"voltage_bias": taken, "current_gain_mismatch": by_another}
    larger = {name: replace(share, relative_to_error=sizes[name]) for name, share in search.contributions.items()}
    monkeypatch.setattr(naming, "fitted_verdict", lambda *_: "unknown_remains")
    monkeypatch.setattr(naming, "residual_fraction_of", lambda *_: 0.01)
    after = drop_confounded(setup.fitter, replace(search, contributions=larger))
    assert ("voltage_bias" not in after.doubtful) == named


@pytest.mark.parametrize("sure", [False, True])
def test_where_nothing_is_sure_nothing_is_found(sure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = _ladder(setup, bare, whole)
    monkeypatch.setattr(naming, "is_none_significant", lambda *_: not sure)
    after = drop_confounded(setup.fitter, search)
    assert after.fit is (search.fit if sure else bare)
    assert after.doubtful == (() if sure else whole.model.names)
    assert set(after.below_materiality) >= set(() if sure else whole.model.names)


@pytest.mark.parametrize("is_needed", [False, True])
def test_what_a_refit_was_refused_without_is_a_cause_although_its_interval_contains_no_effect(
    is_needed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where an amplitude and a shape are confounded, the interval of a linear model is far too wide."""
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    monkeypatch.setattr(naming, "possibly_absent", lambda *_: ["voltage_bias"])
    monkeypatch.setattr(naming, "is_none_significant", lambda *_: True)
    needed = frozenset({"voltage_bias"}) if is_needed else frozenset[str]()
    state = SearchState(setup, whole, bare.chi2_per_dof, is_part=False, is_joint=True, needed=needed)
    search = build_ladder(state, [AcceptedModel(None, bare)])
    assert ("voltage_bias" in [step.added for step in search.steps]) == is_needed
    after = drop_confounded(setup.fitter, search)
    assert ("voltage_bias" in [step.added for step in after.steps]) == is_needed


def test_an_effect_that_the_noise_hides_in_volts_takes_its_part_of_chi2() -> None:
    """Of two that leave nothing, the parts of chi2 add up to the first model's excess, as they are not alike."""
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    shares = _ladder(setup, bare, whole).contributions
    assert sum(one.relative_to_misfit**2 for one in shares.values()) == pytest.approx(1.0, abs=0.1)


CRITERIA = Criteria().selection


def found(name: str, size: float, *twins: str) -> FoundEffect:
    return FoundEffect(name=name, parameters={}, twins=twins, relative_size=size, log_evidence=50.0)


def entry(name: str, size: float, z: float = 20.0) -> JointEntry:
    return JointEntry(name=name, relative_size=size, z=z)


def test_a_larger_effect_that_was_not_named_is_spoken_of() -> None:
    joint = [entry("voltage_delay", 0.21), entry("dead_time", 0.05)]
    remarks = other_opinion(joint, [found("dead_time", 0.05)])
    assert len(remarks) == 1
    assert "voltage_delay is the largest, 0.21 of its typical size" in remarks[0].text


def test_agreement_chance_and_small_differences_are_not_spoken_of() -> None:
    named = [found("dead_time", 0.05, "device_drop")]
    assert other_opinion([entry("dead_time", 0.05)], named) == []
    assert other_opinion([entry("device_drop", 0.3)], named) == []
    assert other_opinion([entry("bus_sag", 0.3, z=3.0)], named) == []
    assert other_opinion([entry("bus_sag", 0.06)], named) == []
    assert other_opinion([entry("bus_sag", 0.3)], []) == []


def test_an_amplitude_of_the_joint_fit_has_its_interval_and_one_that_is_strong_when_small_a_lower_end_alone() -> None:
    bias, loss = VoltageBias.Parameters.declared()[0], EddyCurrents.Parameters.declared()[0]
    found = naming._joint_size(bias, 0.02, 0.01)
    assert found.low is not None
    assert found.high is not None
    assert (found.low, found.value, found.high) == pytest.approx([c * bias.prior_width for c in (0.01, 0.02, 0.03)])
    assert loss.strong_when_small
    bound = naming._joint_size(loss, 0.02, 0.01)
    assert bound.high is None
    assert bound.low == pytest.approx(loss.typical**2 / (0.03 * loss.prior_width))
