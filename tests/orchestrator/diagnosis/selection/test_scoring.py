"""Worth to first order, and by evidence: that of a linear Gaussian model, in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.diagnosis.selection.scoring import (
    fits_as_well,
    linear_view,
    log_bayes_factors,
    log_evidence,
    loss_without,
    probabilities,
    redundant_terms,
    score,
    select_columns,
    select_terms,
    without_effect,
)
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.timing import VoltageDelay
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.1, -0.05])))


def test_gain_in_evidence_is_the_integral_over_a_linear_effects_amplitudes(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    view = linear_view(biased, bare, scaled_library([VoltageBias()], biased.prepared.manifest))
    full = biased.fit(
        bare.model.with_active([view.absent[0].absent()]), bare.linearisation, relinearisations=0, tolerance=0.0
    )
    # int exp(-1/2 |e + A x|^2) N(x; 0, 1) dx, in closed form: pull' (I + A'A)^-1 pull and the determinant.
    spread = np.eye(2) + view.normal
    expected = 0.5 * view.right @ np.linalg.solve(spread, view.right) - 0.5 * np.linalg.slogdet(spread)[1]
    gain = log_evidence(full, 1.0) - log_evidence(replace(bare, chi2=view.fit.chi2), 1.0)
    assert gain == pytest.approx(expected, rel=1e-3)


def test_linear_score_is_the_fall_of_the_objective(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    library = scaled_library([VoltageBias(), VoltageDelay()], biased.prepared.manifest)
    best, other = score(linear_view(biased, bare, library))
    assert (best.candidate.name, other.candidate.name) == ("voltage_bias", "voltage_delay")
    model = bare.model.with_active([best.candidate.absent()])
    fit = biased.fit(model, bare.linearisation, relinearisations=0)
    assert best.gain == pytest.approx(bare.objective - fit.objective, rel=1e-3)


def test_a_rival_does_as_well_by_what_it_leaves_and_not_by_how_many_parameters_it_took(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    (candidate,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    full = biased.fit(bare.model.with_active([candidate.absent()]), bare.linearisation, relinearisations=0)
    assert fits_as_well(full, bare)
    assert not fits_as_well(bare, full)
    least = 2.0 * bare.criteria.selection.tie * max(full.chi2_per_dof, 1.0)
    near, far = (replace(bare, chi2=full.chi2, objective=full.objective + part * least) for part in (0.9, 1.1))
    assert fits_as_well(near, full)
    assert not fits_as_well(far, full)


def test_of_two_that_do_the_same_one_is_worth_freeing() -> None:
    rng = np.random.default_rng(1)
    base = rng.normal(size=(400, 3))
    rows = np.column_stack([base, base[:, 1] + 1e-3 * rng.normal(size=400)])
    normal, right = rows.T @ rows, rows.T @ -base[:, 1]
    kept = select_columns(normal, right, 1, [1, 2, 3], spare=6.0)
    assert kept in ([1], [3])
    # Nothing is, where all that there is may be spared; everything, where nothing may.
    assert select_columns(normal, right, 1, [1, 2, 3], spare=1e9) == []
    assert select_columns(normal, right, 1, [1, 2, 3], spare=-1.0) == [1, 2, 3]
    assert select_columns(normal, right, 1, [], spare=6.0) == []


def test_details_are_worth_bending_only_where_what_is_requested_first_brings_nothing() -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(400, 3))
    view = rows.T @ rows, rows.T @ -(rows[:, 1] + 0.2 * rows[:, 2])
    assert select_terms(view, 1, [([1], 6.0), ([2], 6.0)]) == [1]
    assert select_terms(view, 1, [([], 6.0), ([2], 6.0)]) == [2]
    assert select_terms(view, 1, [([], 6.0), ([2], 1e9)]) == []
    # Of two together what brings most, where the rest may come later.
    assert select_terms(view, 1, [([1, 2], 6.0)]) == [1, 2]
    assert select_terms(view, 1, [([1, 2], 6.0)], later=0.3) == [1]


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


def test_what_an_effect_is_worth_is_what_is_lost_without_it(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    (candidate,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    full = biased.fit(bare.model.with_active([candidate.absent()]), bare.linearisation, relinearisations=0)
    lost = loss_without(full, full.model.active[0], candidate.amplitudes)
    # Wald's test counts in units of the noise that is left.
    assert lost * max(full.chi2_per_dof, 1.0) == pytest.approx(bare.chi2 - full.chi2, rel=0.05)
