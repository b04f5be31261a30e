"""First-order lags: exact for what is linear between samples, at any length of the lag."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from plugins.effects._filters import high_pass_means, low_pass

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
    np.testing.assert_allclose(low_pass(x[:, None], rate)[:, 0], lag, atol=atol)
    np.testing.assert_allclose(high_pass_means(x[:, None], rate)[:-1, 0], means, atol=atol)


def test_nothing_is_left_of_what_rests() -> None:
    still = np.full((5, 2), 3.0)
    np.testing.assert_array_equal(low_pass(still, 0.4), still)
    np.testing.assert_allclose(high_pass_means(still, 0.4), 0.0, atol=1e-12)
    assert high_pass_means(still[:1], 0.4).shape == (1, 2)
