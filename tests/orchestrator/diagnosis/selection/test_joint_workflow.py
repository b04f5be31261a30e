"""Where the joint fit has nothing to say, the search one by one has the word."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, has_fine_grid
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection import joint_workflow
from orchestrator.diagnosis.selection.search_result import AcceptedModel, SearchResult
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.bayes_factors import log_bayes_factors
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from plugins.effects.inverter import VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentGainMismatch
from plugins.effects.timing import VoltageDelay
from protocols import Effect
from tests.orchestrator.diagnosis import pieces as made_of
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import free_model, plan, prepared


def test_effects_that_the_whole_recording_does_not_ask_for_make_no_ladder(monkeypatch: pytest.MonkeyPatch) -> None:
    made = prepared(plan(sparse=True))
    setup = setup_of(made, sensor_noise(made.pieces))
    library = scaled_library([VoltageDelay()], made.manifest)
    bare = setup.fitter.fit(free_model())
    of_a_part = setup.part_fitter.fit(free_model().with_active([library[0].absent()]))
    monkeypatch.setattr(joint_workflow, "joint_search", lambda *_: (of_a_part, {}))
    steps = [AcceptedModel(None, bare)]
    assert joint_workflow.search_jointly(setup, steps, SearchResult(steps), library, InterimRecorder()) is None


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


def test_what_takes_away_about_as_much_as_is_left_is_no_cause() -> None:
    """A biased voltage, and gains that nobody looks for: another resistance in a phase takes some of what they do."""
    setup, bare, whole = _fitted(0.2, [VoltageBias(), PhaseResistanceImbalance()])
    search = joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], whole, {}, [])
    assert search.contributions["phase_resistance_imbalance"].relative_to_error > whole.criteria.selection.named_share
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.below_materiality == ("phase_resistance_imbalance",)


def test_what_takes_away_less_than_is_left_is_no_cause_however_large_its_share() -> None:
    """Another form's error is left: what an effect takes of it, and others could take as well, may be that form's."""
    setup, bare, whole = _fitted(0.02, [VoltageBias(), CurrentGainMismatch()])
    assert joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], whole, {}, []).below_materiality == ()
    lesser, larger = sorted(log_bayes_factors(whole).items(), key=lambda item: item[1])
    between = 0.5 * (lesser[1] + larger[1])
    left = replace(whole, chi2=whole.dof + 2.0 * between)
    assert joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], left, {}, []).below_materiality == (
        lesser[0],
    )


@pytest.mark.parametrize(("left", "named"), [(0.1, True), (0.4, False)])
def test_what_drifts_by_more_than_is_left_disagrees_on_something_else(
    left: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], whole, {}, [])
    monkeypatch.setattr(joint_workflow, "fitted_verdict", lambda *_: "unknown_remains")
    monkeypatch.setattr(joint_workflow, "residual_fraction_of", lambda *_: left)
    monkeypatch.setattr(joint_workflow, "block_scatter_ratio", lambda fit: dict.fromkeys(fit.model.names, 0.3))
    after, doubtful = joint_workflow.drop_confounded(setup.fitter, search)
    assert ("voltage_bias" in doubtful) != named
    assert ("voltage_bias" in [step.added for step in after.steps]) == named
    assert set(after.fit.model.names) == set(whole.model.names)


@pytest.mark.parametrize(
    ("taken", "by_another", "named"), [(3.0, 0.5, True), (30.0, 0.5, False), (3.0, 1.5, True), (3.0, 2.5, False)]
)
def test_what_takes_away_many_times_the_whole_error_or_twice_it_beside_another_is_balanced_and_no_cause(
    taken: float, by_another: float, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], whole, {}, [])
    sizes = {"voltage_bias": taken, "current_gain_mismatch": by_another}
    larger = {name: replace(share, relative_to_error=sizes[name]) for name, share in search.contributions.items()}
    monkeypatch.setattr(joint_workflow, "fitted_verdict", lambda *_: "unknown_remains")
    monkeypatch.setattr(joint_workflow, "residual_fraction_of", lambda *_: 0.01)
    _, doubtful = joint_workflow.drop_confounded(setup.fitter, replace(search, contributions=larger))
    assert ("voltage_bias" not in doubtful) == named


@pytest.mark.parametrize("sure", [False, True])
def test_where_nothing_is_sure_nothing_is_found(sure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    setup, bare, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    search = joint_workflow.build_ladder(setup, [AcceptedModel(None, bare)], whole, {}, [])
    monkeypatch.setattr(joint_workflow, "is_none_significant", lambda *_: not sure)
    after, doubtful = joint_workflow.drop_confounded(setup.fitter, search)
    assert after.fit is (search.fit if sure else bare)
    assert doubtful == ([] if sure else list(whole.model.names))


@pytest.mark.parametrize(("better", "taken"), [(-100.0, True), (100.0, False)])
def test_a_timer_that_the_fit_shows_is_taken_where_all_effects_do_better_with_it(
    better: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, _, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    timed = replace(setup)
    worse = replace(whole, objective=whole.objective + 2.0 * whole.chi2)
    searched = replace(whole, objective=whole.objective + better)
    estimates = iter([(timed, worse), None])
    monkeypatch.setattr(joint_workflow, "refine_quantiser_by_fit", lambda *_: next(estimates))
    monkeypatch.setattr(joint_workflow, "_search_again", lambda *_: (searched, {}))
    after, fit, indistinguishable = joint_workflow.with_quantiser_of_fit(
        setup, whole, {"voltage_bias": ["another"]}, []
    )
    assert after is (timed if taken else setup)
    assert fit is (searched if taken else whole)
    assert indistinguishable == ({} if taken else {"voltage_bias": ["another"]})


@pytest.mark.parametrize(("chi2", "sharper", "requested"), [(1.05, 0.9, False), (3.0, 0.9, True), (3.0, 1.1, True)])
def test_a_sharper_map_is_tried_where_the_forms_leave_something_and_taken_where_it_leaves_less(
    chi2: float, sharper: float, requested: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, _, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    part = setup.part_fitter.fit(whole.model)
    finer, tried = replace(part.model.space, roughness=9.0), list[Fit]()
    fit = replace(part, chi2=chi2 * part.dof, objective=chi2 * part.dof)
    taken = requested and sharper < 1.0

    def with_finest_map(_: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
        tried.append(fit)
        return fitter.fit(replace(fit.model, space=finer)) if len(tried) == 1 else fit

    def free_own_shapes(_: Fitter, trial: Fit) -> Fit:
        return replace(trial, chi2=chi2 * trial.dof, objective=sharper * fit.objective)

    monkeypatch.setattr(joint_workflow, "record_finest_map", with_finest_map)
    monkeypatch.setattr(joint_workflow, "free_own_shapes", free_own_shapes)
    after = joint_workflow.refine_joint_map(setup, fit)
    assert [len(one.model.free) for one in tried] == [0, 0][: requested + taken]
    assert (after.model.space is finer) == taken
    assert (after is fit) != taken
    assert [name for _, name in after.model.free] == [name for _, name in fit.model.free]


@pytest.mark.parametrize("earned", [False, True])
def test_a_map_that_was_made_sharp_for_what_others_took_away_later_is_a_usual_one(
    earned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup, _, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    space = replace(whole.model.space, roughness=9.0, prior=whole.model.space.prior / 9.0)
    sharp = setup.fitter.fit(replace(whole.model, space=space))
    if earned:
        monkeypatch.setattr(joint_workflow, "keep_fine_grid", lambda *_: True)
    after = joint_workflow.coarsen_joint_map(setup, sharp)
    assert has_fine_grid(sharp)
    assert (after is sharp) == earned
    assert has_fine_grid(after) == earned
    assert set(after.model.names) == set(whole.model.names)


def test_a_usual_map_is_requested_nothing() -> None:
    setup, _, whole = _fitted(0.2, [VoltageBias(), CurrentGainMismatch()])
    assert joint_workflow.coarsen_joint_map(setup, whole) is whole
