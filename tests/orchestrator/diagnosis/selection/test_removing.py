"""An effect goes where the data do not ask for it, and makes room for one that does better in its place."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.form_mixture import FormMixture
from orchestrator.diagnosis.selection import removing, scoring
from orchestrator.diagnosis.selection.removing import (
    merge_moves,
    other_form_moves,
    remove_moves,
    swap_moves,
    tied_moves,
)
from orchestrator.diagnosis.selection.scoring import redundant_terms
from orchestrator.diagnosis.selection.search_state import SearchState, evidence_gain
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentOffset
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import R_S, fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import errors_of, joint_state, made, state_of, view_of


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


def test_what_the_data_do_not_ask_for_goes(biased: Fitter) -> None:
    library = scaled_library([DeadTime(), VoltageBias(), PhaseResistanceImbalance()], biased.prepared.manifest)
    state = joint_state(biased, [c.absent() for c in library])
    after = made(next(remove_moves(state)))
    assert after.fit.model.names == ("voltage_bias",)
    # A first removal may have been wrong: what went may come back.
    assert after.refused == ()
    assert not list(remove_moves(after))
    late = replace(state, late=frozenset({"dead_time"}))
    assert made(next(remove_moves(late))).refused == ("dead_time",)


def test_what_blocks_disagree_on_stays_where_much_is_lost_with_it(
    biased: Fitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bias,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    state = joint_state(biased, [bias.absent()])
    monkeypatch.setattr(scoring, "block_scatter", lambda f: np.full(len(f.model.free), 10.0))
    assert redundant_terms(state.fit) == ["voltage_bias"]
    after = made(next(remove_moves(state)))
    assert after.fit is state.fit
    assert after.needed == {"voltage_bias"}
    # It is not tried again until the model gains something.
    assert not list(remove_moves(after))
    assert list(remove_moves(after.after(after.fit)))


def test_what_is_not_needed_goes_although_a_weaker_effect_is(biased: Fitter, monkeypatch: pytest.MonkeyPatch) -> None:
    library = scaled_library([DeadTime(), VoltageBias(), PhaseResistanceImbalance()], biased.prepared.manifest)
    state = joint_state(biased, [c.absent() for c in library])
    order = ["voltage_bias", "dead_time", "phase_resistance_imbalance"]
    monkeypatch.setattr(removing, "redundant_terms", lambda fit: [n for n in order if n in fit.model.names])
    after = made(next(remove_moves(state)))
    assert after.fit.model.names == ("voltage_bias",)
    assert after.needed == {"voltage_bias"}


def test_the_weakest_effect_is_left_out_on_trial_on_the_whole(biased: Fitter, monkeypatch: pytest.MonkeyPatch) -> None:
    library = scaled_library([VoltageBias(), PhaseResistanceImbalance()], biased.prepared.manifest)
    state = replace(joint_state(biased, [c.absent() for c in library]), is_part=False)
    monkeypatch.setattr(removing, "redundant_terms", lambda _: [])
    assert not list(remove_moves(replace(state, is_part=True)))
    (move,) = remove_moves(state)
    assert move.concerned == ("phase_resistance_imbalance",)
    after = made(move)
    assert after.fit.model.names == ("voltage_bias",)


@pytest.mark.parametrize(("more_than_forms", "stays"), [(1.1, True), (0.9, False), (-1.0, False)])
def test_an_effect_goes_whose_evidence_over_other_forms_of_the_others_would_not_have_added_it(
    biased: Fitter, more_than_forms: float, stays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = scaled_library([VoltageBias(), PhaseResistanceImbalance()], biased.prepared.manifest)
    state = replace(joint_state(biased, [c.absent() for c in library]), is_part=False)
    mixed = []

    def mixture(_: Fitter, trial: Fit, names: tuple[str, ...]) -> FormMixture:
        mixed.append(names)
        evidence = evidence_gain(state.fit, trial) - more_than_forms * state.limits.log_evidence
        return FormMixture(names, 0.5, evidence * state.noise, np.zeros(0), np.zeros((0, 0)))

    monkeypatch.setattr(removing, "mix_forms", mixture)
    (weakest, _) = other_form_moves(state)
    assert weakest.concerned[0] == "phase_resistance_imbalance"
    after = weakest.make()
    assert mixed == [("voltage_bias",)]
    assert (after is None) == stays
    assert after is None or after.refused == ("phase_resistance_imbalance",)
    assert not list(other_form_moves(replace(state, is_part=True)))


def test_what_only_fits_the_noise_of_the_fitted_stages_goes_by_the_held_out_ones(
    biased: Fitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    (bias,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    state = replace(joint_state(biased, [bias.absent()]), is_part=False)
    (move,) = remove_moves(state)
    assert made(move).fit is state.fit
    monkeypatch.setattr(removing, "prediction_gain", lambda *_: -1e9)
    assert made(move).fit.model.names == ()


def _with_resistance(of_resistance: float) -> SearchState:
    """A biased voltage, and so much more of R_s in phase a, both in the model."""
    given = with_voltage(prepared(plan(), noise_a=0.002), np.array([2.0, -1.0]))
    extra = {p.segment.id: of_resistance * R_S * p.signals.i_ab * np.array([1.0, 0.0]) for p in given.pieces}
    maker = fitter(with_voltage(given, extra))
    bare = maker.fit(free_model())
    model = with_free(with_free(bare.model, maker, VoltageBias()), maker, PhaseResistanceImbalance())
    terms = [with_free(bare.model, maker, effect).active[0] for effect in (VoltageBias(), PhaseResistanceImbalance())]
    fit = maker.fit(model.with_active(terms))
    return state_of(maker, fit, first_chi2=bare.chi2_per_dof, is_part=False)


@pytest.mark.parametrize(("of_resistance", "gone"), [(4e-4, ()), (0.0, ("phase_resistance_imbalance",))])
def test_what_takes_the_rest_to_the_noise_is_named_however_large_the_first_error_was(
    of_resistance: float, gone: tuple[str, ...]
) -> None:
    state = _with_resistance(of_resistance)
    assert state.first_chi2 > 1e5 > 1e4 * state.fit.chi2_per_dof
    after = next((after for move in remove_moves(state) if (after := move.make()) is not None), state)
    assert after.refused == gone


def test_an_effect_makes_room_for_one_that_does_better_in_its_place(biased: Fitter) -> None:
    library = scaled_library([CurrentOffset(), VoltageBias()], biased.prepared.manifest)
    wrong = joint_state(biased, [library[0].absent()])
    view = view_of(wrong, library)
    assert not list(swap_moves(replace(wrong, is_part=False), view))
    (move,) = swap_moves(wrong, view)
    right = made(move)
    assert right.fit.model.names == ("voltage_bias",)
    assert set(right.indistinguishable) <= {"voltage_bias"}
    back = next((m.make() for m in swap_moves(right, view_of(right, library))), None)
    assert back is None or back.fit is right.fit


def test_of_two_that_tied_when_one_was_added_the_one_with_the_better_form_stays() -> None:
    """A drop over devices that conduct from a knee on, begun as a dead time."""
    recording = prepared(plan(), noise_a=0.002)
    library = scaled_library([DeadTime(), DeviceDrop()], recording.manifest)
    dead_time, drop = (c.absent() for c in library)
    true = replace(drop, values={**drop.values, "voltage_v": 0.8, "threshold_a": 0.2, "growth": 0.6})
    maker = fitter(with_voltage(recording, errors_of(true, recording)))
    state = state_of(maker)
    begun = dead_time.moved("voltage_v", 0.1).release("threshold_a")
    wrong = state.after(state.minimum(state.fit.model.with_active([begun])))
    wrong = replace(wrong, indistinguishable={"dead_time": ("device_drop",)}, gains={"dead_time": 1.0})
    (move,) = tied_moves(wrong, library)
    right = made(move)
    assert right.fit.model.names == ("device_drop",)
    assert right.fit.chi2_per_dof < wrong.fit.chi2_per_dof
    assert right.indistinguishable == {"device_drop": ("dead_time",)}
    (back,) = tied_moves(right, library)
    assert back.make() is None


@pytest.mark.slow
@pytest.mark.parametrize("softness", [0.15, 0.75])
def test_two_effects_of_one_kind_are_no_more_than_one_of_another_form(softness: float) -> None:
    recording = prepared(plan(), noise_a=0.002)
    library = scaled_library([DeadTime(), DeviceDrop()], recording.manifest)
    absent = library[0].absent()
    wanted = {"voltage_v": 0.8, "threshold_a": 0.1, "softness": softness}
    true = replace(absent, values={**absent.values, **wanted})
    maker = fitter(with_voltage(recording, errors_of(true, recording)))
    # One PWM frequency: only their forms tell them apart.
    both = [
        c.absent().moved(c.amplitudes[0], x).release("threshold_a") for c, x in zip(library, (-0.1, 0.6), strict=True)
    ]
    (move,) = merge_moves(joint_state(maker, both))
    after = made(move)
    (kept,) = after.fit.model.names
    (gone,) = {"dead_time", "device_drop"} - {kept}
    assert after.indistinguishable == {kept: (gone,)}
    assert after.refused == (gone,)
    assert after.fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / after.fit.dof))


@pytest.mark.slow
def test_of_two_effects_of_one_kind_the_lesser_stays_where_it_alone_has_the_form() -> None:
    """A dead time that charges capacitances all along, begun as much of a drop and a little of itself."""
    recording = prepared(plan(), noise_a=5e-4)
    library = scaled_library([DeadTime(), DeviceDrop()], recording.manifest)
    absent = library[0].absent()
    wanted = {"voltage_v": 4.8, "threshold_a": 0.3, "charged": 1.0}
    true = replace(absent, values={**absent.values, **wanted})
    maker = fitter(with_voltage(recording, errors_of(true, recording)))
    both = [
        c.absent().moved(c.amplitudes[0], x).release("threshold_a") for c, x in zip(library, (0.1, 2.0), strict=True)
    ]
    (move,) = merge_moves(joint_state(maker, both))
    (kept,) = made(move).fit.model.active
    assert kept.name == "dead_time"
    assert kept.values["voltage_v"] == pytest.approx(4.8, rel=5e-3)
    assert kept.values["charged"] == pytest.approx(1.0, abs=0.05)
