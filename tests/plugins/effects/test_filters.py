"""First-order lags: exact for what is linear between samples, at any length of the lag."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, lfilter, lfilter_zi

from orchestrator.numerics.types import Array
from plugins.effects._filters import high_pass_means, low_pass, second_order
from plugins.effects._vectors import Starts


def alone(x: Array, rate: float) -> tuple[Starts, Array]:
    """The bounds and the rate of one segment."""
    return np.array([0, len(x)]), np.array([rate])


FINE = 2000
"""Explicit Euler steps in a sampling interval."""


def _integrated(x: Array, rate: float) -> tuple[Array, Array]:
    """The lag at each sample, and the mean over each interval of what it leaves, in many small steps."""
    y, lag, means = float(x[0]), [float(x[0])], []
    for before, after in pairwise(x):
        line = before + (after - before) * (np.arange(FINE) + 0.5) / FINE
        left = 0.0
        for value in line:
            y += rate / FINE * (value - y)
            left += (value - y) / FINE
        lag.append(y)
        means.append(left)
    return np.array(lag), np.array(means)


@pytest.mark.parametrize("rate", [0.02, 0.3, 5.0])
def test_a_lag_is_exact_for_straight_lines_between_samples(rate: float) -> None:
    x = np.random.default_rng(3).normal(size=8)
    lag, means = _integrated(x, rate)
    atol = 2.0 * rate / FINE * float(np.abs(x).max())
    np.testing.assert_allclose(low_pass(x, *alone(x, rate)), lag, atol=atol)
    np.testing.assert_allclose(high_pass_means(x[:, None], *alone(x, rate))[:-1, 0], means, atol=atol)


def test_nothing_is_left_of_what_rests() -> None:
    still = np.full((5, 2), 3.0)
    np.testing.assert_array_equal(low_pass(still[:, 0], *alone(still, 0.4)), still[:, 0])
    np.testing.assert_allclose(high_pass_means(still, *alone(still, 0.4)), 0.0, atol=1e-12)
    assert high_pass_means(still[:1], *alone(still[:1], 0.4)).shape == (1, 2)


def test_each_segment_lags_from_its_own_first_value_at_its_own_rate() -> None:
    x, starts, rates = np.random.default_rng(4).normal(size=(9, 2)), np.array([0, 5, 6, 9]), np.array([0.1, 0.4, 2.0])
    parts = [x[first:end] for first, end in pairwise(starts)]
    expected = [low_pass(part[:, 0].copy(), *alone(part, rate)) for part, rate in zip(parts, rates, strict=True)]
    np.testing.assert_array_equal(low_pass(x[:, 0].copy(), starts, rates), np.concatenate(expected))
    expected = [high_pass_means(part, *alone(part, rate)) for part, rate in zip(parts, rates, strict=True)]
    np.testing.assert_array_equal(high_pass_means(x, starts, rates), np.concatenate(expected))


def test_a_filter_of_second_order_is_scipys_in_the_segments_requested() -> None:
    x, starts = np.random.default_rng(5).normal(size=30), np.array([0, 12, 20, 30])
    above, below = butter(2, 0.3)
    resting, y = lfilter_zi(above, below), np.zeros(30)
    second_order(y, x, starts, np.array([0, 2]), above, below, resting)
    for first, end in ((0, 12), (20, 30)):
        expected = lfilter(above, below, x[first:end], zi=resting * x[first])[0]
        np.testing.assert_allclose(y[first:end], expected, rtol=0.0, atol=1e-12)
    assert not y[12:20].any()
