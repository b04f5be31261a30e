"""Against the numbers of the NIST/SEMATECH e-Handbook of Statistical Methods, https://www.itl.nist.gov/div898/handbook/."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from orchestrator.numerics.process_control import (
    EwmaSettings,
    capability,
    deviation_between_neighbours,
    ewma,
    share_beyond,
)
from orchestrator.numerics.types import Array

# Section 6.3.2.4, with weight 0.3, target 50 and standard deviation 2.0539.
MEASURED = (
    52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5, 49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4,
    53.6, 52.1,
)  # fmt: skip
AVERAGED = (
    50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33, 50.11, 49.36, 49.52, 50.05, 49.38, 49.92,
    50.73, 51.23, 51.94, 51.99,
)  # fmt: skip
LIMITS = (47.4115, 52.5884)


def scaled_to(count: int, mean: float, deviation: float) -> Array:
    """A sample with exactly this mean and standard deviation."""
    values = norm.ppf((np.arange(count) + 0.5) / count)
    return np.asarray(mean + deviation * (values - values.mean()) / values.std(ddof=1), dtype=np.float64)


def test_the_moving_average_and_its_limits_are_the_handbooks() -> None:
    chart = ewma(np.array(MEASURED), 50.0, 2.0539, EwmaSettings(weight=0.3, width=3.0))
    np.testing.assert_allclose(chart.average, AVERAGED, atol=0.0051)
    assert (chart.lower[-1], chart.upper[-1]) == pytest.approx(LIMITS, abs=2e-3)
    assert not chart.beyond.any()


def test_a_chart_is_left_soon_after_a_step_and_seldom_without() -> None:
    rng = np.random.default_rng(0)
    still = ewma(rng.normal(size=20000), 0.0, 1.0)
    runs = int(np.sum(np.diff(still.beyond.astype(int)) == 1))
    assert 15 <= runs <= 60  # one in 500, of the averages that begin to be beyond
    moved = ewma(np.concatenate([rng.normal(size=50), rng.normal(size=50) + 1.5]), 0.0, 1.0)
    assert not moved.beyond[:50].any()
    assert moved.beyond[50:65].any()


def test_cpk_is_the_handbooks() -> None:
    # Section 6.1.6: limits 8 and 20, mean 16, standard deviation 2.
    found = capability(scaled_to(50, 16.0, 2.0), 8.0, 20.0)
    assert found is not None
    assert found.value == pytest.approx(0.6667, abs=1e-4)
    half = 1.96 * np.sqrt(1.0 / (9.0 * 50.0) + 0.6667**2 / (2.0 * 49.0))
    assert (found.low, found.high) == pytest.approx((0.6667 - half, 0.6667 + half), abs=1e-3)


def test_one_limit_is_enough_and_none_or_one_value_is_not() -> None:
    values = scaled_to(30, 1.0, 0.1)
    upper, lower = capability(values, None, 1.4), capability(values, 0.4, None)
    assert upper is not None
    assert lower is not None
    assert upper.value == pytest.approx(4.0 / 3.0)
    assert lower.value == pytest.approx(2.0)
    assert capability(values, None, None) is None
    assert capability(np.ones(5), 0.0, 2.0) is None
    assert capability(np.ones(1), 0.0, 2.0) is None


def test_the_interval_of_cpk_holds_the_truth_19_times_of_20() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(1000):
        found = capability(rng.normal(size=40), -3.0, 5.0)
        assert found is not None
        held += found.low <= 1.0 <= found.high
    assert 925 <= held <= 975


def test_a_slow_drift_does_not_widen_the_deviation_between_neighbours() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=2000) + np.linspace(0.0, 50.0, 2000)
    assert deviation_between_neighbours(values) == pytest.approx(1.0, rel=0.08)
    assert deviation_between_neighbours(values[:1]) == 0.0


def test_the_share_beyond_is_clopper_and_pearsons() -> None:
    # Section 7.2.4.1 of the handbook: 4 of 20, two-sided 90 % 0.071354 to 0.401029; here 95 %.
    assert share_beyond(4, 20) == pytest.approx((0.057334, 0.436614), abs=1e-5)
    assert share_beyond(0, 100) == pytest.approx((0.0, 0.036217), abs=1e-5)
    assert share_beyond(3, 3)[1] == 1.0
