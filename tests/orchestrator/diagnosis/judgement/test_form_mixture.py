"""A mixture of an effect's forms takes up what another form leaves, and little of an effect that is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.form_mixture import FORMS, mix_forms
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from plugins.effects.inverter import DeadTime
from plugins.effects.sensors import CurrentGainMismatch
from plugins.effects.timing import VoltageDelay
from protocols import Effect
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_effects

POINTS = np.array([[0.0, 0.0], [1.5, 0.0], [-1.5, 0.5], [0.0, 1.5], [1.0, 1.0]])


def measured_with(*hidden: tuple[Effect, dict[str, float]]) -> Fitter:
    """A recording of a plant with some effects, as its readings show them."""
    maker = fitter(prepared(plan()))
    terms = []
    for effect, values in hidden:
        (candidate,) = scaled_library([effect], maker.prepared.manifest)
        absent = candidate.absent()
        terms.append(EffectTerm(candidate, {**absent.values, **values}, absent.free))
    return fitter(with_effects(maker.prepared, terms))


def fitted(maker: Fitter, effect: Effect) -> Fit:
    """A fit with one effect in its simplest form."""
    (candidate,) = scaled_library([effect], maker.prepared.manifest)
    present = candidate.absent().moved(candidate.amplitudes[0], 0.1)
    return maker.fit(free_model().with_active([present]))


@pytest.fixture(scope="module")
def other_form() -> Fitter:
    """A dead time of two knees, far from each other."""
    return measured_with(
        (DeadTime(), {"voltage_v": -0.4, "threshold_a": 0.02}), (DeadTime(), {"voltage_v": -0.4, "threshold_a": 0.7})
    )


def test_a_mixture_takes_up_what_another_form_leaves(other_form: Fitter) -> None:
    fit = fitted(other_form, DeadTime())
    assert fit.chi2_per_dof > 1.5
    mixture = mix_forms(other_form, fit, ["dead_time"])
    assert mixture is not None
    assert mixture.effects == ("dead_time",)
    assert mixture.is_detected
    assert mixture.share > 0.8


def test_a_mixture_takes_up_little_of_an_effect_that_is_missing() -> None:
    maker = measured_with((DeadTime(), {"voltage_v": -0.8}), (VoltageDelay(), {"delay_s": -4e-6}))
    fit = fitted(maker, DeadTime())
    assert fit.chi2_per_dof > 1.5
    mixture = mix_forms(maker, fit, ["dead_time"])
    assert mixture is not None
    assert mixture.share < 0.2


def test_the_effects_own_form_needs_no_mixture() -> None:
    maker = measured_with((DeadTime(), {"voltage_v": -0.8}))
    mixture = mix_forms(maker, fitted(maker, DeadTime()), ["dead_time"])
    assert mixture is not None
    assert mixture.log_evidence < 16.0


def test_an_effect_of_one_form_has_no_mixture() -> None:
    maker = measured_with((CurrentGainMismatch(), {"gain": -0.01}))
    fit = fitted(maker, CurrentGainMismatch())
    assert mix_forms(maker, fit, ["current_gain_mismatch"]) is None
    assert mix_forms(maker, fit, []) is None


def test_the_maps_band_includes_what_another_form_moves(other_form: Fitter) -> None:
    fit = fitted(other_form, DeadTime())
    plain = MapUncertainty.of(other_form, fit)
    wider = plain.with_mixture(mix_forms(other_form, fit, ["dead_time"]))
    assert wider.band_wb(POINTS) > plain.band_wb(POINTS)
    assert plain.with_mixture(None) is plain


def test_the_same_forms_are_drawn_every_time(other_form: Fitter) -> None:
    fit = fitted(other_form, DeadTime())
    one, other = (mix_forms(other_form, fit, ["dead_time"]) for _ in range(2))
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one.shift, other.shift)


def test_terms_in_other_forms_have_names_of_their_own() -> None:
    maker = measured_with((DeadTime(), {"voltage_v": -0.8}))
    (candidate,) = scaled_library([DeadTime()], maker.prepared.manifest)
    assert replace(candidate, alias="dead_time in form 1").name == "dead_time in form 1"
    assert candidate.name == "dead_time"
    assert FORMS & (FORMS - 1) == 0, "low-discrepancy points come in powers of two"
