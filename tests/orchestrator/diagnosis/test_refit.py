"""A model that is refitted by hand is on a map as fine as the data ask for then."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis._refit import _refine_map
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from protocols import Saturated
from tests.orchestrator.diagnosis.fitting.conftest import setup

__all__ = ["setup"]


@pytest.mark.slow
def test_a_map_gets_the_detail_that_is_requested_when_nothing_else_is_missing(sharp: DiagnosisSetup) -> None:
    """A coarse one does while an effect is missing, and would keep its error when that is added."""
    coarse = sharp.fitter.fit(baseline_model(sharp, Saturated()))
    fine = _refine_map(sharp, coarse)
    assert max(fine.model.space.grid.cells) > max(coarse.model.space.grid.cells)
    assert fine.chi2_per_dof - 1.0 < 0.5 * (coarse.chi2_per_dof - 1.0)


@pytest.mark.parametrize("again", [False, True])
def test_a_map_that_is_fine_enough_stays(setup: DiagnosisSetup, again: bool) -> None:
    fit = setup.fitter.fit(baseline_model(setup, Saturated()))
    if again:
        fit = _refine_map(setup, fit)
    assert _refine_map(setup, fit) is fit
