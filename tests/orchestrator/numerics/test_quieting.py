"""A record without its noise: what stays, what goes, and that a jump is left as it was read."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.quieting import quieted
from orchestrator.numerics.types import Array

SIGMA = 0.004


def _noisy(clean: Array, seed: int = 1) -> Array:
    return np.asarray(clean + np.random.default_rng(seed).normal(0.0, SIGMA, clean.shape))


def _ripple(n: int) -> Array:
    t = np.arange(n) / 1e4
    return np.stack([np.cos(2 * np.pi * 5 * t), 0.05 * np.sin(2 * np.pi * 503.7 * t)], axis=1)


@pytest.mark.parametrize(("n", "left_over"), [(400, 0.8), (4000, 0.5)])
def test_noise_goes_and_the_signal_stays_the_more_so_the_longer_the_record(n: int, left_over: float) -> None:
    clean = _ripple(n)
    left = quieted(_noisy(clean), np.full(2, SIGMA)) - clean
    assert np.all(left.std(axis=0) < left_over * SIGMA)


def test_a_constant_is_nearly_the_mean_of_its_readings() -> None:
    noisy = _noisy(np.full((4000, 2), 0.3))
    quiet = quieted(noisy, np.full(2, SIGMA))
    np.testing.assert_allclose(quiet.mean(axis=0), noisy.mean(axis=0), atol=0.02 * SIGMA)
    assert np.all(quiet.std(axis=0) < 0.25 * SIGMA)


def test_a_jump_stands_where_it_was_read() -> None:
    clean = np.zeros((1000, 1))
    clean[437:] = 1.0
    noisy = _noisy(clean)
    quiet = quieted(noisy, np.full(1, SIGMA))
    assert np.abs(quiet - noisy).max() <= 4.0 * SIGMA


def test_without_noise_nothing_changes() -> None:
    clean = _ripple(1000)
    np.testing.assert_allclose(quieted(clean, np.zeros(2)), clean, atol=1e-12)
