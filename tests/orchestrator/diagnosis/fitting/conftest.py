"""First models of a linear machine, and of one whose iron saturates from zero flux on."""

import pytest

from orchestrator.diagnosis.fitting import baseline
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, fit_baseline
from orchestrator.diagnosis.fitting.model import Fit
from tests.orchestrator.diagnosis.pieces import fitter, plan, prepared, setup_of


@pytest.fixture(scope="package")
def setup() -> DiagnosisSetup:
    return setup_of(fitter(prepared(plan())))


@pytest.fixture(scope="package")
def linear_fit(setup: DiagnosisSetup) -> Fit:
    return fit_baseline(setup)


@pytest.fixture(scope="package")
def sharp_fit_without_kink(sharp: DiagnosisSetup) -> Fit:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baseline, "_refined_with_kink", lambda *_: None)
        return fit_baseline(sharp)
