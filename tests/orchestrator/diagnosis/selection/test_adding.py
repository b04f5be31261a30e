"""Effects are added one by one by their evidence, or many at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.selection.adding import add_moves, full_model, sub_threshold_effects
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.sensors import CurrentOffset
from plugins.effects.timing import VoltageDelay
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import errors_of, joint_state, made, state_of, view_of


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


def test_an_effect_that_explains_little_of_the_misfit_is_only_noted(biased: Fitter) -> None:
    library = scaled_library([VoltageBias()], biased.prepared.manifest)
    state = state_of(biased)
    (move,) = add_moves(state, view_of(state, library), library)
    assert made(move).fit.model.names == ("voltage_bias",)
    poor = state.after(replace(state.fit, chi2=50.0 * state.fit.chi2))
    assert not list(add_moves(poor, view_of(poor, library), library))
    assert sub_threshold_effects(state, view_of(state, library)) == ["voltage_bias"]
    assert sub_threshold_effects(poor, view_of(poor, library)) == []


def test_an_effect_that_removes_the_misfit_is_added_however_small_it_is(biased: Fitter) -> None:
    (bias,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    huge = replace(bias, parameters=tuple(replace(p, typical=100.0 * p.typical) for p in bias.parameters))
    state = state_of(biased)
    (move,) = add_moves(state, view_of(state, [huge]), [huge])
    (added,) = made(move).fit.model.active
    assert added.relative_size < 0.02


def test_what_the_recording_cannot_separate_from_a_present_effect_is_not_added() -> None:
    recording = prepared(plan())
    library = scaled_library([DeadTime(), DeviceDrop()], recording.manifest)
    active = library[0].absent().moved("voltage_v", 4.0)
    maker = fitter(with_voltage(recording, errors_of(active, recording)))
    state = state_of(maker)
    (both,) = add_moves(state, view_of(state, library), library)
    assert set(both.concerned) == {"dead_time", "device_drop"}
    after = made(both)
    assert after.fit.model.names == ("dead_time",)
    assert not list(add_moves(after, view_of(after, library), library))


def test_to_a_joint_model_several_effects_are_added_at_once(biased: Fitter) -> None:
    library = scaled_library([VoltageBias(), CurrentOffset()], biased.prepared.manifest)
    state = joint_state(biased, [])
    (move,) = add_moves(state, view_of(state, library), library)
    after = made(move)
    assert set(after.fit.model.names) == set(move.concerned) == after.late
    assert "voltage_bias" in move.concerned


def test_the_full_model_keeps_the_effects_that_are_there(biased: Fitter) -> None:
    library = scaled_library([VoltageDelay(), VoltageBias()], biased.prepared.manifest)
    fit = biased.fit(with_free(free_model(), biased, VoltageBias()))
    joint = full_model(state_of(biased, fit), library)
    assert joint.fit.model.names == ("voltage_delay", "voltage_bias")
    assert joint.fit.chi2 == pytest.approx(fit.chi2, rel=0.02)
