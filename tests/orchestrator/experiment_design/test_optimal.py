"""Weights are optimal where the equivalence theorem says so: on designs that are known, and by no better one near."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.experiment_design.optimal import derivatives, optimal_weights
from orchestrator.numerics.types import Array

X = np.linspace(-1.0, 1.0, 21)
CUBIC = np.stack([X**k for k in range(4)], axis=1)
NOTHING = 1e-12 * np.eye(4)


def rates(rows: Array) -> Array:
    return np.asarray(np.einsum("jx,jy->jxy", rows, rows))


def criterion(weights: Array, interest: Array, prior: Array, time: float) -> float:
    whole = prior + time * np.tensordot(weights, rates(CUBIC), 1)
    others = np.setdiff1d(np.arange(4), interest)
    of_others = np.linalg.slogdet(whole[np.ix_(others, others)])[1] if len(others) else 0.0
    return float(np.linalg.slogdet(whole)[1] - of_others)


def test_a_line_is_measured_at_its_ends() -> None:
    design = optimal_weights(rates(CUBIC[:, :2]), 1e-12 * np.eye(2), np.arange(2), 1.0, tolerance=1e-6, max_steps=5000)
    assert design.weights[[0, -1]] == pytest.approx([0.5, 0.5], abs=1e-3)


def test_a_parabola_s_bend_alone_asks_for_half_of_the_time_in_the_middle() -> None:
    # Kiefer and Wolfowitz' own example: 1/4, 1/2, 1/4 where the highest coefficient alone is of interest.
    parabola = rates(CUBIC[:, :3])
    design = optimal_weights(parabola, 1e-12 * np.eye(3), np.array([2]), 1.0, tolerance=1e-5, max_steps=50_000)
    assert design.weights[[0, 10, 20]] == pytest.approx([0.25, 0.5, 0.25], abs=5e-3)


@pytest.mark.parametrize("interest", [[0, 1, 2, 3], [1, 3], [2]])
def test_the_theorem_holds_to_a_hundredth_and_its_bound_is_the_number_of_interest(interest: list[int]) -> None:
    design = optimal_weights(rates(CUBIC), NOTHING, np.array(interest), 1.0, tolerance=0.01, max_steps=50_000)
    assert design.excess <= 0.01
    assert design.bound == pytest.approx(len(interest), rel=1e-6)
    assert design.weights.sum() == pytest.approx(1.0)


def test_derivatives_are_those_of_the_criterion() -> None:
    interest, weights, prior = np.array([1, 3]), np.linspace(1.0, 2.0, 21) / 31.5, 0.1 * np.eye(4)
    slopes = derivatives(rates(CUBIC), prior, interest, weights, 7.0)
    for k in (0, 7, 20):
        step = np.zeros(21)
        step[k] = 1e-6
        ahead, behind = (criterion(weights + side * step, interest, prior, 7.0) for side in (1, -1))
        assert slopes[k] == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


def test_no_other_share_of_the_time_is_better_by_more_than_the_excess() -> None:
    interest, prior = np.array([1, 3]), 0.05 * np.eye(4)
    design = optimal_weights(rates(CUBIC), prior, interest, 3.0, tolerance=0.005, max_steps=50_000)
    best = criterion(design.weights, interest, prior, 3.0)
    for share in np.random.default_rng(1).dirichlet(np.full(21, 0.3), size=200):
        # Concave: the criterion is nowhere above its tangents.
        assert criterion(share, interest, prior, 3.0) <= best + design.largest - design.bound
