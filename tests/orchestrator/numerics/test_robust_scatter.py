"""Scatter of data of which a third is anything."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from orchestrator.numerics.robust_scatter import Concentration, Scatter, robust_scatter
from orchestrator.numerics.types import Array

QUICK = Concentration(starts=100)


def sample(count: int, size: int = 4, seed: int = 1) -> Array:
    """Correlated normal data."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, size)) @ rng.normal(size=(size, size)) + rng.normal(size=size)


def test_distances_are_the_same_after_any_linear_map() -> None:
    rows = sample(150)
    rows[:30] += 20.0
    turn = np.random.default_rng(2).normal(size=(4, 4))
    mapped = rows @ turn + np.array([1e6, -3.0, 0.0, 1e-3])
    before, after = robust_scatter(rows, QUICK), robust_scatter(mapped, QUICK)
    assert np.array_equal(before.counted, after.counted)
    np.testing.assert_allclose(after.squares(mapped), before.squares(rows), rtol=1e-5)
    np.testing.assert_allclose(after.covariance, turn.T @ before.covariance @ turn, rtol=1e-4)


def test_units_that_differ_by_ten_to_the_twelfth_change_nothing() -> None:
    rows = sample(100)
    scaled = rows * np.array([1e-6, 1.0, 1e6, 1e3])
    before, after = robust_scatter(rows, QUICK), robust_scatter(scaled, QUICK)
    np.testing.assert_allclose(after.squares(scaled), before.squares(rows), rtol=1e-6)


@pytest.mark.parametrize("far", [8.0, 1e3, 1e9])
def test_a_third_of_wild_rows_in_one_heap_is_found_and_moves_nothing(far: float) -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(300, 4))
    rows[:90] += far
    found = robust_scatter(rows, QUICK)
    out = found.squares(rows) > found.limits(0.05 / 300, np.full(300, 4))
    assert out[:90].all()
    assert out[90:].sum() <= 1
    assert np.abs(found.middle).max() < 0.25
    assert np.abs(found.covariance - np.eye(4)).max() < 0.35


def test_of_a_clean_normal_sample_scatter_is_the_true_one_and_nothing_is_out() -> None:
    alarms = 0
    for seed in range(10):
        rows = np.random.default_rng(seed).normal(size=(120, 4))
        found = robust_scatter(rows, QUICK)
        alarms += int((found.squares(rows) > found.limits(0.05 / 120, np.full(120, 4))).any())
        assert 0.6 < np.linalg.det(found.covariance) ** 0.25 < 1.4
    assert alarms <= 3  # of ten fleets, each with a chance of one in twenty


def test_the_limit_goes_to_that_of_a_known_covariance() -> None:
    many = Scatter(np.zeros(3), np.eye(3), np.ones(1_000_000, dtype=bool))
    assert many.limits(0.01, np.array([3]))[0] == pytest.approx(chi2.isf(0.01, 3), rel=1e-3)


def test_what_is_missing_in_a_row_leaves_the_others_marginal_distance() -> None:
    found = Scatter(np.zeros(2), np.array([[1.0, 0.9], [0.9, 1.0]]), np.ones(50, dtype=bool))
    row = np.array([[2.0, np.nan], [np.nan, np.nan]])
    assert found.squares(row)[0] == pytest.approx(4.0)
    assert np.isnan(found.squares(row)[1])


def test_parts_add_up_to_the_distance_and_name_what_is_strange() -> None:
    covariance = np.array([[4.0, 0.0, 0.0], [0.0, 1.0, 0.95], [0.0, 0.95, 1.0]])
    found = Scatter(np.zeros(3), covariance, np.ones(50, dtype=bool))
    row = np.array([0.5, 2.0, -2.0])
    parts = found.parts(row)
    assert parts.sum() == pytest.approx(found.squares(row[None])[0])
    assert parts[0] < 0.01 * parts.sum()
    assert parts[1] == pytest.approx(parts[2])


def test_what_lies_in_a_plane_or_is_too_few_is_refused() -> None:
    rows = sample(60, 3)
    with pytest.raises(np.linalg.LinAlgError, match="one plane"):
        robust_scatter(np.column_stack([rows, rows[:, 0] - rows[:, 1]]), QUICK)
    with pytest.raises(np.linalg.LinAlgError, match="6 rows are too few for 3"):
        robust_scatter(rows[:6], QUICK)


def test_many_rows_are_tried_on_a_part_and_ended_on_all() -> None:
    rows = sample(4000, 3)
    rows[::3] += 30.0
    found = robust_scatter(rows, Concentration(starts=50, max_rows=300))
    assert not found.counted[::3].any()
    assert found.counted.sum() > 0.9 * len(rows) * 2.0 / 3.0
