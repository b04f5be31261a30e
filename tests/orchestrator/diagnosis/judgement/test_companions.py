"""Of two effects that act alike the sum is determined, and each says so beside the zero that fits it."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.judgement.companions import MIN_CORRELATION, companions
from orchestrator.diagnosis.judgement.intervals import standardised_covariance
from plugins.effects.inverter import VoltageBias
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


class OtherBias(VoltageBias):
    name = "other_bias"


MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))


def test_of_two_that_act_alike_the_sum_is_determined_and_each_names_the_other() -> None:
    terms = [with_free(free_model(), MAKER, effect).active[0] for effect in (VoltageBias(), OtherBias())]
    fit = MAKER.fit(free_model().with_active(terms))
    found = companions(fit, standardised_covariance(MAKER, fit))
    first, second = found["voltage_bias", "bias_a_v"], found["other_bias", "bias_a_v"]
    assert (first.effect, first.parameter) == ("other_bias", "bias_a_v")
    assert (second.effect, second.parameter) == ("voltage_bias", "bias_a_v")
    assert first.total is not None
    assert first.total_low is not None
    assert first.total_high is not None
    assert first.total_low < 0.3 < first.total_high
    assert first.total_high - first.total_low < 0.05


def test_one_alone_has_no_companion_and_weak_correlations_are_none() -> None:
    fit = MAKER.fit(with_free(free_model(), MAKER, VoltageBias()))
    assert companions(fit, standardised_covariance(MAKER, fit)) == {}
    x = [active.standardised_value(name) for active, name in fit.model.free]
    wide = np.abs(x).max() * np.array([[1.0, -1.0], [-1.0, 1.0]])
    weak = 0.9 * MIN_CORRELATION * wide + np.diag(np.diag(wide)) * (1.0 - 0.9 * MIN_CORRELATION)
    assert companions(fit, weak) == {}
