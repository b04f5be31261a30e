"""From fits to figures: verdicts, the part that is left, and what noise alone would make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.ladder import found_effects, left_fraction, mean_rms_v, noise_rms_v, verdict_of
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitted_bias(MAKER)


def _with_chi2(fit: Fit, chi2: float) -> Fit:
    return replace(fit, chi2=chi2 * fit.dof)


@pytest.mark.parametrize(
    ("before", "after", "effects", "verdict"),
    [
        (1.02, 1.02, 0, "clean"),
        (500.0, 1.05, 1, "explained"),
        (900.0, 2.0, 1, "explained"),  # a thirtieth of the error
        (101.0, 2.0, 1, "mostly_explained"),  # a tenth
        (11.0, 2.2, 1, "unknown_remains"),  # a third
        (1e6, 150.0, 1, "unknown_remains"),  # a hundredth, but more than a wrong shape leaves
        (500.0, 500.0, 0, "unknown_remains"),
    ],
)
def test_verdict_asks_for_little_beside_the_first_error_and_little_in_itself(
    fit: Fit, before: float, after: float, effects: int, verdict: str
) -> None:
    assert verdict_of(_with_chi2(fit, before), _with_chi2(fit, after), effects) == verdict


def test_what_is_left_is_a_ratio_of_amplitudes(fit: Fit) -> None:
    assert left_fraction(101.0, _with_chi2(fit, 2.0)) == pytest.approx(0.1)
    assert left_fraction(1.05, _with_chi2(fit, 1.05)) == 0.0
    assert left_fraction(101.0, _with_chi2(fit, 0.9)) == 0.0


def test_a_fit_to_the_noise_leaves_the_noise(fit: Fit) -> None:
    floor, left = noise_rms_v(fit), mean_rms_v(fit, lambda _: True)
    assert floor is not None
    assert left == pytest.approx(floor, rel=0.15)
    assert mean_rms_v(fit, lambda _: False) is None
    assert noise_rms_v(fit, lambda _: False) is None
    bare = MAKER.fit(free_model())
    assert (mean_rms_v(bare, lambda _: True) or 0.0) > 3.0 * floor


def test_intervals_hold_what_was_put_in_and_are_as_wide_as_asked_for(fit: Fit) -> None:
    (effect,) = found_effects(MAKER, fit, {}, {"voltage_bias": ["current_offset"]})
    assert effect.twins == ("current_offset",)
    for name, truth in (("bias_a_v", 0.3), ("bias_b_v", -0.15)):
        told = effect.parameters[name]
        assert told.value is not None
        assert told.low is not None
        assert told.high is not None
        assert told.low < truth < told.high
        assert told.unit == "V"
