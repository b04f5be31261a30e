"""Errors in volts, and what noise alone would make of them."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.ladder import kept_rungs, mean_rms_v, noise_rms_v, rung
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, setup_of, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitted_bias(MAKER)


def test_a_fit_to_the_noise_leaves_the_noise(fit: Fit) -> None:
    floor, left = noise_rms_v(fit), mean_rms_v(fit, lambda _: True)
    assert floor is not None
    assert left == pytest.approx(floor, rel=0.15)
    assert mean_rms_v(fit, lambda _: False) is None
    assert noise_rms_v(fit, lambda _: False) is None
    bare = MAKER.fit(free_model())
    assert (mean_rms_v(bare, lambda _: True) or 0.0) > 3.0 * floor


def test_a_rung_is_its_fit_in_numbers(fit: Fit) -> None:
    reported = rung(AcceptedModel("voltage_bias", fit))
    assert reported.added == "voltage_bias"
    assert reported.effects == ("voltage_bias",)
    assert reported.chi2 == fit.chi2_per_dof
    assert reported.rms_v == mean_rms_v(fit, lambda p: not p.held_out)
    assert reported.heldout_rms_v == mean_rms_v(fit, lambda p: p.held_out)
    assert reported.current_rms_a == pytest.approx(0.004, rel=0.5)


def test_a_rung_that_is_kept_is_the_model_held_against_the_recording(fit: Fit) -> None:
    setup = setup_of(MAKER)
    (kept,) = kept_rungs(setup, [AcceptedModel(None, fit)])
    assert kept.chi2 == pytest.approx(fit.chi2_per_dof, rel=0.01)
