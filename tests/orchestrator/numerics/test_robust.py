"""Against what textbooks print, and against what a few wild values must not do."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.robust import Thinning, holm, paired_shift, shift, slope, spread

# M. Hollander, D. A. Wolfe, Nonparametric Statistical Methods: water through membranes, and patients before and after;
# R's wilcox.test has both as examples.
AT_TERM = np.array([0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46])
EARLY = np.array([1.15, 0.88, 0.90, 0.74, 1.21])
BEFORE = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
AFTER = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])


def test_a_shift_is_the_books() -> None:
    found = shift(AT_TERM, EARLY)
    assert found.value == pytest.approx(0.305)
    assert (found.low, found.high) == pytest.approx((-0.15, 0.76))


def test_a_paired_shift_is_the_books() -> None:
    found = paired_shift(BEFORE - AFTER)
    assert found.value == pytest.approx(0.46)
    assert (found.low, found.high) == pytest.approx((0.010, 0.786), abs=0.04)


def test_of_many_values_a_part_tells_the_same() -> None:
    rng = np.random.default_rng(0)
    values, others = rng.normal(size=600) + 0.3, rng.normal(size=500)
    whole, part = shift(values, others), shift(values, others, Thinning(max_values=100))
    assert part.value == pytest.approx(whole.value, abs=0.02)
    assert (part.low, part.high) == pytest.approx((whole.low, whole.high), abs=0.02)
    same, thinned = paired_shift(values), paired_shift(values, Thinning(max_values=100))
    assert (thinned.low, thinned.high) == pytest.approx((same.low, same.high), abs=0.02)


def test_a_slope_stands_while_a_quarter_of_the_values_is_wild() -> None:
    rng = np.random.default_rng(1)
    x = np.arange(200.0)
    y = 0.5 * x + rng.normal(size=200)
    y[150:] -= 1e4 * rng.random(50)
    found = slope(x[:150], y[:150])
    assert found.low < 0.5 < found.high
    assert slope(x, np.where(np.arange(200) % 4 == 0, 1e5, 0.5 * x)).value == pytest.approx(0.5, abs=0.01)


def test_a_slope_over_groups_is_the_slope() -> None:
    rng = np.random.default_rng(2)
    x = np.sort(rng.random(3000))
    found = slope(x, 2.0 * x + 0.1 * rng.normal(size=3000), Thinning(max_values=200))
    assert found.low < 2.0 < found.high
    assert found.chance < 1e-10


def test_intervals_of_shift_and_slope_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(3)
    held = np.zeros(3)
    for _ in range(150):
        a, b = rng.normal(size=25) + 1.0, rng.normal(size=15)
        for k, (found, truth) in enumerate(
            ((shift(a, b), 1.0), (paired_shift(a), 1.0), (slope(np.arange(25.0), a - 1.0), 0.0))
        ):
            held[k] += found.low <= truth <= found.high
    assert (held / 150 > 0.90).all()


def test_spread_is_a_normal_samples_deviation() -> None:
    values = np.random.default_rng(4).normal(size=20001)
    assert spread(values) == pytest.approx(1.0, rel=0.03)
    values[:6000] = 1e6
    assert spread(values) < 2.5


def test_chances_are_weighed_as_holm_does() -> None:
    weighed = holm(np.array([0.01, 0.04, np.nan, 0.03, 0.005]))
    np.testing.assert_allclose(weighed, [0.03, 0.06, np.nan, 0.06, 0.02])
