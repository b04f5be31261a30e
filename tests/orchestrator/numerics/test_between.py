"""Mean and spread of a population from values with known errors."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.between import population


def test_mean_and_spread_come_out_from_behind_errors_as_large() -> None:
    rng = np.random.default_rng(0)
    errors = rng.uniform(0.5, 2.0, size=400)
    found = population(3.0 + rng.normal(size=400) + errors * rng.normal(size=400), errors)
    assert found.mean == pytest.approx(3.0, abs=0.25)
    assert found.between == pytest.approx(1.0, abs=0.2)
    assert found.std == pytest.approx(found.between, rel=0.02)


def test_the_next_one_lies_within_two_deviations_as_often_as_it_should() -> None:
    rng = np.random.default_rng(1)
    inside, widths = 0, []
    for _ in range(400):
        errors = np.full(10, 0.5)
        values = rng.normal(size=11)
        found = population(values[:10] + errors * rng.normal(size=10), errors)
        inside += abs(values[10] - found.mean) < 1.96 * found.std
        widths.append(found.std)
    assert 0.93 <= inside / 400 <= 0.99
    assert np.median(widths) < 1.6


def test_a_spread_that_does_not_show_is_not_taken_for_none() -> None:
    rng = np.random.default_rng(2)
    values = 0.1 * rng.normal(size=8)
    found = population(values, np.full(8, 1.0))
    assert 0.0 < found.between < 1.0
    assert found.std > 0.3


def test_values_without_errors_give_their_own_deviation_and_units_do_not_matter() -> None:
    values = np.random.default_rng(3).normal(size=200)
    found = population(values, np.zeros(200))
    assert found.between == pytest.approx(np.std(values, ddof=1), rel=0.02)
    scaled = population(1e-9 * values, np.zeros(200))
    assert scaled.std == pytest.approx(1e-9 * found.std, rel=1e-9)
