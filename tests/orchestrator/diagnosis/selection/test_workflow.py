"""The course of a diagnosis, step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import has_fine_grid
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.selection import workflow
from orchestrator.diagnosis.selection.search_result import AcceptedModel, SearchResult
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.workflow import (
    coarsen_map,
    prune,
    search_effects,
    with_estimated_scatter,
)
from plugins.effects.inverter import VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from protocols import SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import (
    R_S,
    fitter,
    free_model,
    many_holds,
    plan,
    prepared,
    setup_of,
    timer,
    with_voltage,
)


def _biased(of_resistance: float) -> tuple[Fitter, list[AcceptedModel]]:
    """A biased voltage, and so much more of R_s in phase a; the ladder of both."""
    biased = with_voltage(prepared(plan(), noise_a=0.002), np.array([2.0, -1.0]))
    extra = {p.segment.id: of_resistance * R_S * p.signals.i_ab * np.array([1.0, 0.0]) for p in biased.pieces}
    maker = fitter(with_voltage(biased, extra))
    steps = [AcceptedModel(None, maker.fit(free_model()))]
    for effect in (VoltageBias(), PhaseResistanceImbalance()):
        before = steps[-1].fit.model
        model = before.with_active([*before.active, *with_free(before, maker, effect).active])
        steps.append(AcceptedModel(effect.name, maker.fit(model), 100.0))
    return maker, steps


@pytest.mark.parametrize(("of_resistance", "spared"), [(4e-4, []), (0.0, ["phase_resistance_imbalance"])])
def test_what_takes_the_rest_to_the_noise_is_named_however_large_the_first_error_was(
    of_resistance: float, spared: list[str]
) -> None:
    maker, steps = _biased(of_resistance)
    assert steps[0].fit.chi2_per_dof > 1e5 > 1e4 * steps[-1].fit.chi2_per_dof
    setup = setup_of(maker)
    assert prune(setup, SearchResult(steps))[1] == spared


def test_voltages_that_differ_by_chance_are_noise() -> None:
    made, rng = prepared(many_holds()), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    setup = setup_of(fitter(with_voltage(made, by_chance)))
    fit = setup.fitter.fit(free_model())
    noisy = with_estimated_scatter(setup, fit, [])
    assert noisy is not None
    assert noisy.fitter.noise.of_model.scatters
    assert noisy.fitter.fit(free_model()).chi2_per_dof < 1.2


@pytest.mark.parametrize("earned", [False, True])
def test_a_map_that_was_made_sharp_for_an_effect_s_form_is_a_usual_one(
    earned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    maker = fitter(with_voltage(prepared(plan()), np.array([0.3, 0.0])))
    first = maker.fit(free_model())
    biased = with_free(first.model, maker, VoltageBias())
    space = replace(first.model.space, roughness=9.0, prior=first.model.space.prior / 9.0)
    usual, sharp = maker.fit(biased), maker.fit(replace(biased, space=space))
    if earned:
        monkeypatch.setattr(workflow, "keep_fine_grid", lambda *_: True)
    search = SearchResult([AcceptedModel(None, first), AcceptedModel("voltage_bias", sharp, 20.0)])
    after = coarsen_map(setup_of(maker), search)
    assert has_fine_grid(sharp)
    assert has_fine_grid(after.fit) == earned
    assert after.fit.model.names == ("voltage_bias",)
    asked_nothing = SearchResult([AcceptedModel(None, first), AcceptedModel("voltage_bias", usual, 20.0)])
    assert coarsen_map(setup_of(maker), asked_nothing) is asked_nothing


def test_a_timer_that_leaves_more_than_none_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = setup_of(fitter(with_voltage(prepared(plan(), noise_a=0.002), np.array([0.05, 0.0]))))
    steps = [AcceptedModel(None, setup.fitter.fit(free_model()))]
    assert steps[0].fit.chi2_per_dof > 1.08
    monkeypatch.setattr(
        workflow, "with_detected_quantiser", lambda given, *_: given.with_quantiser(timer(2e-6, 0.3, 0.6))
    )
    timed, _ = search_effects(setup, steps, [], InterimRecorder())
    assert timed.prepared.quantiser is None
    monkeypatch.setattr(
        workflow, "with_detected_quantiser", lambda given, *_: given.with_quantiser(timer(1e-12, 0.3, 0.6))
    )
    timed, _ = search_effects(setup, steps, [], InterimRecorder())
    assert timed.prepared.quantiser is not None
