"""Where a model that fits says nothing, it is said why."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.shares import excitation_v, why_nothing_is_told
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitter(prepared(plan(sparse=True))).fit(free_model())


def test_a_model_that_says_something_needs_no_excuse(fit: Fit) -> None:
    assert not why_nothing_is_told(fit, 0.05 * excitation_v(fit), 0.01)
    assert not why_nothing_is_told(fit, None, None)


def test_noise_beside_the_excitation_and_a_current_that_runs_off_are_told(fit: Fit) -> None:
    excited = excitation_v(fit)
    noise, runs_off = why_nothing_is_told(fit, 0.5 * excited, 0.46)
    assert noise.values["noise_mv"] == pytest.approx(500.0 * excited)
    assert noise.values["excited_mv"] == pytest.approx(1e3 * excited)
    assert "46 % of its range" in runs_off.text
