"""Grid and nuisances change where the fit gains by it, and are as they were elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, has_fine_grid, on_usual_grid, with_kink_switched
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate
from orchestrator.diagnosis.selection import environment_moves
from orchestrator.diagnosis.selection.environment_moves import (
    coarser_map_moves,
    first_map_moves,
    kink_moves,
    map_moves,
    noise_moves,
    refine_quantiser_by_fit,
    with_detected_quantiser,
)
from orchestrator.diagnosis.selection.scoring import redundant_terms
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import Move, SearchState
from plugins.effects.frame import BrakeBacklash
from plugins.effects.inverter import DeadTime, VoltageBias
from protocols import SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import (
    NOISE_A,
    felt_through,
    fitter,
    free_model,
    many_holds,
    plan,
    prepared,
    setup_of,
    timer,
    with_voltage,
)
from tests.orchestrator.diagnosis.selection.states import made, state_of
from tests.support.cases import few


def test_voltages_that_differ_by_chance_are_noise() -> None:
    recording, rng = prepared(many_holds()), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in recording.pieces if p.stage is SegmentStage.RESISTANCE}
    state = state_of(fitter(with_voltage(recording, by_chance)))
    (move,) = noise_moves(state, [])
    after = made(move)
    assert after.fitter.noise.of_model.scatters
    assert after.fit.chi2_per_dof < 1.2
    assert not list(noise_moves(after, []))


def _biased(**fields: bool) -> SearchState:
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))
    return state_of(maker, maker.fit(with_free(free_model(), maker, VoltageBias())), **fields)


@pytest.mark.parametrize("keeps", [False, True])
@pytest.mark.parametrize("is_joint", [False, True])
def test_a_fine_map_that_no_longer_gains_is_a_usual_one(
    keeps: bool, is_joint: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _biased(is_part=False, is_joint=is_joint)
    space = state.fit.model.space
    rough = replace(space, roughness=np.full((1, 1), 9.0), prior=space.prior / 9.0)
    fine = state.after(state.minimum(replace(state.fit.model, space=rough)))
    assert has_fine_grid(fine.fit)
    monkeypatch.setattr(environment_moves, "is_finer_map_justified", lambda *_: keeps)
    (move,) = coarser_map_moves(fine)
    after = move.make()
    assert (after is None) == keeps
    if after is not None:
        assert not has_fine_grid(after.fit)
        assert after.fit.model.names == ("voltage_bias",)
    assert not list(coarser_map_moves(state))


@pytest.mark.parametrize("gain", [100.0, 40.0])
def test_a_finer_map_is_made_in_place_of_an_effect_that_gains_less(
    gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _biased()
    with_effect = state.after(replace(state.fit, objective=state.fit.objective - 50.0))

    def with_finest_map(_: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
        return replace(fit, objective=fit.objective - gain)

    monkeypatch.setattr(environment_moves, "with_finest_map", with_finest_map)
    (move,) = first_map_moves(state, Move("add", ("some",), lambda: with_effect))
    after = made(move)
    assert state.fit.objective - after.fit.objective == max(gain, 50.0)
    assert (after is with_effect) == (gain < 50.0)
    # Nothing else to do: any gain will do.
    (alone,) = first_map_moves(state, None)
    assert made(alone).fit.objective < state.fit.objective


@pytest.mark.parametrize(("gain", "taken"), [(100.0, True), (-100.0, False)])
@pytest.mark.parametrize("is_joint", [False, True])
def test_a_finer_map_is_taken_where_all_together_leave_less_with_it(
    gain: float, taken: bool, is_joint: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _biased(is_joint=is_joint)
    finer, tried = replace(state.fit.model.space, roughness=np.full((1, 1), 9.0)), list[Fit]()

    def with_finest_map(_: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
        tried.append(fit)
        found = fitter.fit(replace(fit.model, space=finer))
        return replace(found, objective=state.fit.objective - gain)

    monkeypatch.setattr(environment_moves, "with_finest_map", with_finest_map)
    if is_joint:
        better = replace(state.fit, objective=state.fit.objective - gain)
        monkeypatch.setattr(SearchState, "minimum", lambda *_: better)
    (move,) = map_moves(state)
    assert (move.make() is not None) == taken
    # The maps of a joint model are compared with its effects fixed.
    assert bool(tried[0].model.free) != is_joint


@pytest.mark.parametrize(("gain", "taken"), [(100.0, True), (-100.0, False)])
def test_a_timer_that_the_fit_shows_is_taken_where_all_effects_do_better_with_it(
    gain: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _biased(is_joint=True)
    estimate = QuantiserEstimate(timer(21.7e-9, 0.40, 0.58), 9.0, np.zeros((3, 3)))
    state = replace(state, setup=replace(state.setup, quantisers=(estimate,)))
    timed, fit = replace(state.setup), replace(state.fit, objective=state.fit.objective - gain)
    monkeypatch.setattr(environment_moves, "refine_quantiser_by_fit", lambda *_: (timed, fit))
    (move,) = (move for move in noise_moves(state, []) if move.kind == "quantiser")
    after = move.make()
    assert (after is not None) == taken
    assert after is None or (after.setup is timed and after.fit is fit)
    # Effects that were added one by one do not tell a timer's rounding.
    assert all(move.kind != "quantiser" for move in noise_moves(replace(state, is_joint=False), []))


@pytest.mark.slow
def test_iron_that_saturates_from_zero_flux_on_is_no_play_of_the_brake(sharp: DiagnosisSetup, sharp_fit: Fit) -> None:
    usual = sharp.fitter.fit(on_usual_grid(sharp, sharp_fit), relinearisations=0)
    smooth = with_kink_switched(sharp, sharp.fitter, usual)
    (play,) = scaled_library([BrakeBacklash()], sharp.prepared.manifest)
    state = SearchState(sharp, smooth, smooth.chi2_per_dof, is_part=False)
    state = state.after(with_effect(sharp, smooth, play))
    assert state.fit.chi2 < 0.9 * smooth.chi2
    assert not redundant_terms(state.fit)
    (move,) = kink_moves(state)
    after = made(move)
    assert after.fit.model.space.grid.kink
    # The kink alone leaves less than the play does on a smooth map.
    assert after.fit.chi2 < state.fit.chi2
    assert sharp_fit.chi2 < state.fit.chi2


@pytest.mark.parametrize(("gain", "taken"), [(5.0, True), (1.0, False)])
@pytest.mark.parametrize("has_kink", [False, True])
def test_a_kink_comes_and_goes_by_its_evidence(
    gain: float, taken: bool, has_kink: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = _biased(is_part=False)
    if has_kink:
        state = state.after(with_kink_switched(state.setup, state.fitter, state.fit))
    evidence = {has_kink: 0.0, not has_kink: gain * state.noise}
    monkeypatch.setattr(environment_moves, "map_log_evidence", lambda fit: evidence[fit.model.space.grid.kink])
    (move,) = kink_moves(state)
    assert move.kind == ("coarser_map" if has_kink else "finer_map")
    after = move.make()
    assert (after is not None) == taken
    assert after is None or after.fit.model.space.grid.kink != has_kink
    assert not list(kink_moves(replace(state, is_part=True)))
    assert not list(kink_moves(state.after(replace(state.fit, chi2=50.0 * state.fit.dof))))


@pytest.mark.parametrize(("chi2_per_dof", "again"), [(5.0, True), (50.0, False)])
def test_a_finer_map_is_tried_for_each_set_of_effects_where_a_map_may_be_what_is_left(
    chi2_per_dof: float, again: bool
) -> None:
    state = _biased()
    fit = replace(state.fit, chi2=chi2_per_dof * state.fit.dof)
    less = replace(fit, model=fit.model.with_active([]))
    (first,) = map_moves(state.after(fit))
    assert not list(map_moves(state.after(less)))
    two = [*fit.model.active, *with_free(fit.model, state.fitter, DeadTime()).active]
    (second,) = map_moves(state.after(replace(fit, model=fit.model.with_active(two))))
    assert (first.key(state) != second.key(state)) == again


def test_voltages_that_differ_by_chance_are_no_timer_s() -> None:
    made, rng = prepared(many_holds()), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    setup = setup_of(fitter(with_voltage(made, by_chance)))
    assert with_detected_quantiser(setup, setup.fitter.fit(free_model()), []) is setup


def test_a_timer_is_reported_again_where_a_fit_with_it_leaves_something() -> None:
    true, off = timer(21.7e-9, 0.35, 0.62), timer(21.7e-9, 0.40, 0.58)
    felt = felt_through(true, plan(), noise_a=0.002)
    given = replace(setup_of(fitter(felt)), quantisers=(QuantiserEstimate(off, 9.0, np.zeros((3, 3))),))
    setup = given.with_quantiser(off)
    fit = setup.part_fitter.fit(free_model())
    assert fit.chi2_per_dof > 1.08
    timer_and_fit = refine_quantiser_by_fit(setup, fit, [])
    assert timer_and_fit is not None
    timed, beside = timer_and_fit
    assert beside.chi2_per_dof < 1.08
    assert timed.prepared.quantiser == beside.prepared.quantiser
    assert timed.prepared.quantiser is not None
    (at,) = timed.prepared.quantiser.phases
    # Which of the two edges is which, mean voltages do not say.
    assert sorted((at.rise, at.fall)) == pytest.approx((0.35, 0.62), abs=0.01)
    # Nothing is left beside the right one.
    assert refine_quantiser_by_fit(timed, beside, []) is None


@few("rounding", [0, 3, 4, 7], fast=2)
def test_where_a_descent_meets_a_command_s_jump_it_goes_on_beyond(rounding: int) -> None:
    """Which way a descent goes between jumps is decided by the last digits: all have to lead to the timer."""
    off = timer(21.7e-9, 0.40, 0.58)
    felt = felt_through(timer(21.7e-9, 0.35, 0.62), plan(), noise_a=NOISE_A * (1.0 + 1e-9 * rounding))
    given = replace(setup_of(fitter(felt)), quantisers=(QuantiserEstimate(off, 9.0, np.zeros((3, 3))),))
    setup = given.with_quantiser(off)
    timer_and_fit = refine_quantiser_by_fit(setup, setup.part_fitter.fit(free_model()), [])
    assert timer_and_fit is not None
    timed, beside = timer_and_fit
    assert beside.chi2_per_dof < 1.06
    assert timed.prepared.quantiser is not None
    (at,) = timed.prepared.quantiser.phases
    assert sorted((at.rise, at.fall)) == pytest.approx((0.35, 0.62), abs=0.035)


@pytest.mark.slow
def test_a_timer_is_taken_out_of_every_voltage() -> None:
    rng, plans = np.random.default_rng(4), [*many_holds(), *(p for p in plan() if p.stage is SegmentStage.CLASSICAL)]
    # Current control trembles with the readings' noise.
    trembling = [
        p
        if p.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE)
        else replace(p, v_dq=np.tile(p.v_dq, (4, 1)) + rng.normal(0.0, 0.3, (4 * len(p.v_dq), 2)))
        for p in plans
    ]
    rounded = felt_through(timer(21.7e-9, 0.35, 0.35), trembling, noise_a=0.001)
    setup = setup_of(fitter(rounded))
    fit = setup.fitter.fit(free_model())
    timed = with_detected_quantiser(setup, fit, [])
    assert timed.prepared.quantiser is not None
    assert timed.prepared.quantiser.step_s == pytest.approx(21.7e-9, rel=1e-4)
    assert timed.part_fitter.prepared.quantiser == timed.prepared.quantiser
    with_it = timed.fitter.fit(free_model())
    assert with_it.chi2_per_dof - 1.0 < 0.1 * (fit.chi2_per_dof - 1.0)
    # As commanded again, the timer is not in the voltages.
    for piece, first in zip(timed.with_quantiser(None).prepared.pieces, rounded.pieces, strict=True):
        np.testing.assert_array_equal(piece.signals.v_ab, first.signals.v_ab)
