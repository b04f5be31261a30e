"""The search names what is there, and nothing in noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.criteria import Criteria, SelectionCriteria
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.selection.forward_search import Step, forward
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.timing import VoltageDelay
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.1, -0.05])))


def test_the_search_names_what_is_there_and_nothing_beside_it(biased: Fitter) -> None:
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], biased.prepared.manifest)
    search = forward(biased, [Step(None, biased.fit(free_model()))], library)
    assert [step.added for step in search.steps] == [None, "voltage_bias"]
    assert search.fit.chi2_per_dof == pytest.approx(1.0, abs=0.2)


def test_noise_alone_is_given_no_name() -> None:
    maker = fitter(prepared(plan(sparse=True), seed=3))
    library = scaled_library([VoltageBias(), VoltageDelay(), DeadTime()], maker.prepared.manifest)
    search = forward(maker, [Step(None, maker.fit(free_model()))], library)
    assert [step.added for step in search.steps] == [None]
    assert search.traces == []


def test_thresholds_are_those_that_are_handed_in(biased: Fitter) -> None:
    strict = Criteria(selection=SelectionCriteria(log_evidence=1e9))
    maker = replace(biased, prepared=replace(biased.prepared, criteria=strict))
    search = forward(
        maker, [Step(None, maker.fit(free_model()))], scaled_library([VoltageBias()], maker.prepared.manifest)
    )
    assert len(search.steps) == 1
