"""Penalised least squares by themselves: against the same thing written out, and on data of their own model."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.reml import most_likely
from tests.orchestrator.analysis.plant import Array


def made(size: float, seed: int, count: int = 80) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(count, 23))
    modes = np.concatenate([np.array([5.0, -3.0, 100.0]), size * random.normal(size=20)])
    return rows, rows @ modes + random.normal(size=count), modes


def written_out(rows: Array, target: Array, free: int, t: float) -> float:
    """Minus twice the logarithm of the restricted likelihood, by the data's covariance."""
    x, z = rows[:, :free], rows[:, free:]
    covariance = np.eye(len(rows)) + t * z @ z.T
    inverse = np.linalg.inv(covariance)
    seen = x.T @ inverse @ x
    off = target - x @ np.linalg.solve(seen, x.T @ inverse @ target)
    return float(np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(seen)[1] + off @ inverse @ off)


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_the_restricted_likelihood_is_the_largest(size: float) -> None:
    rows, target, _ = made(size, 4)
    costs = [written_out(rows, target, 3, t) for t in np.geomspace(1e-4, 1e4, 161)]
    assert most_likely(rows, target, 3).cost == pytest.approx(min(costs), abs=0.05)


def test_intervals_hold_free_modes_and_others() -> None:
    inside = []
    for seed in range(60):
        rows, target, modes = made(0.5, seed)
        found = most_likely(rows, target, 3)
        std = np.linalg.norm(found.root, axis=1)
        inside.append(np.abs(found.modes - modes) < 1.96 * std)
    assert 0.92 < np.mean(inside) < 0.98


def test_modes_that_are_not_there_are_nearly_zero() -> None:
    rows, target, modes = made(0.0, 1)
    found = most_likely(rows, target, 3)
    assert np.abs(found.modes[3:]).max() < 0.1
    np.testing.assert_allclose(found.modes[:3], modes[:3], atol=0.5)


def test_a_free_mode_that_no_datum_sees_stays_zero() -> None:
    rows, target, _ = made(0.5, 2)
    rows[:, 1] = 0.0
    found = most_likely(rows, target, 3)
    assert np.isfinite(found.modes).all()
    assert abs(found.modes[1]) < 1e-6
