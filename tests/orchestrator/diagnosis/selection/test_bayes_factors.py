"""One fit says how much the data ask for each effect."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.diagnosis.selection.bayes_factors import (
    log_bayes_factors,
    probabilities,
    redundant_terms,
    without_effect,
)
from plugins.effects.inverter import DeadTime, VoltageBias
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


@pytest.fixture(scope="module")
def fit(maker: Fitter) -> Fit:
    return maker.fit(with_free(free_model(), maker, VoltageBias()))


def test_evidence_is_what_the_density_at_nothing_says(maker: Fitter, fit: Fit) -> None:
    """For one amplitude: log N(0; 0, 1) - log N(0; x, s), from the fit's own normal matrix."""
    bias = fit.model.active[0]
    one = fit.model.with_active([replace(bias, free=("bias_a_v",))])
    single = maker.evaluate(one, maker.linearise(one))
    factor = log_bayes_factors(single)["voltage_bias"]
    noise = np.linalg.inv(single.projected()[0] / max(single.chi2_per_dof, 1.0) + np.eye(1))[0, 0]
    between = block_scatter(single)[0] ** 2 / BLOCKS
    x, s = bias.standardised_value("bias_a_v"), math.sqrt(noise + between)
    assert factor == pytest.approx(math.log(s) + 0.5 * (x / s) ** 2)
    assert redundant_terms(single) == []
    assert probabilities(single)["voltage_bias"] == pytest.approx(1.0)


def test_an_effect_of_no_size_can_go(maker: Fitter, fit: Fit) -> None:
    (dead_time,) = scaled_library([DeadTime()], maker.prepared.manifest)
    more = fit.model.with_active([*fit.model.active, dead_time.absent()])
    beside = maker.evaluate(more, maker.linearise(more))
    assert redundant_terms(beside) == ["dead_time"]
    assert probabilities(beside)["dead_time"] < 0.2


def test_what_is_left_without_an_effect_is_more(maker: Fitter, fit: Fit) -> None:
    assert without_effect(maker, fit, "voltage_bias").chi2 > 10.0 * fit.chi2
