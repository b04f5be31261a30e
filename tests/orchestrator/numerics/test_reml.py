"""Penalised least squares by themselves: against the same thing written out, and on data of their own model."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.reml import RestrictedLikelihood, most_likely
from orchestrator.numerics.types import Array

FREE = 3


def made(size: float, seed: int, count: int = 80) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(count, 23))
    modes = np.concatenate([np.array([5.0, -3.0, 100.0]), size * random.normal(size=20)])
    return rows, rows @ modes + random.normal(size=count), modes


def written_out(rows: Array, target: Array, t: float, noise_known: bool = True) -> float:
    """Minus twice the logarithm of the restricted likelihood, by the data's covariance."""
    x, z = rows[:, :FREE], rows[:, FREE:]
    covariance = np.eye(len(rows)) + t * z @ z.T
    inverse = np.linalg.inv(covariance)
    seen = x.T @ inverse @ x
    off = target - x @ np.linalg.solve(seen, x.T @ inverse @ target)
    squares = float(off @ inverse @ off)
    spread = float(np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(seen)[1])
    return spread + (squares if noise_known else (len(rows) - FREE) * np.log(squares))


@pytest.mark.parametrize("noise_known", [True, False])
@pytest.mark.parametrize("t", [1e-4, 0.1, 1.0, 1e4])
def test_the_restricted_likelihood_is_that_of_the_datas_covariance(t: float, noise_known: bool) -> None:
    rows, target, _ = made(0.3, 4)
    likelihood = RestrictedLikelihood(rows, target, FREE, noise_known=noise_known, ridge=0.0)
    assert likelihood.cost(1.0 / t) == pytest.approx(written_out(rows, target, t, noise_known), rel=1e-8)


@pytest.mark.parametrize("noise_known", [True, False])
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_the_largest_is_found(size: float, noise_known: bool) -> None:
    rows, target, _ = made(size, 4)
    likelihood = RestrictedLikelihood(rows, target, FREE, noise_known=noise_known)
    found = likelihood.likeliest((-6.0, 16.0), likelihood.largest_information, tolerance=1e-5)
    assert likelihood.cost(found) <= min(likelihood.cost(p) for p in np.geomspace(1e-4, 1e4, 161))


def test_the_modes_are_those_of_generalised_least_squares() -> None:
    rows, target, _ = made(0.5, 7)
    penalty = np.diag([0.0] * FREE + [2.0] * (rows.shape[1] - FREE))
    covariance = np.linalg.inv(rows.T @ rows + penalty)
    found = RestrictedLikelihood(rows, target, FREE).solution(2.0)
    np.testing.assert_allclose(found.coefficients, covariance @ rows.T @ target, rtol=1e-8)
    size = float(np.diag(covariance).max())
    np.testing.assert_allclose(found.root @ found.root.T, covariance, rtol=0.0, atol=1e-10 * size)


def test_the_free_modes_unit_changes_nothing() -> None:
    rows, target, _ = made(0.5, 3)
    scales = np.where(np.arange(rows.shape[1]) < FREE, 1e6, 1.0)
    one, other = most_likely(rows, target, FREE), most_likely(rows * scales, target, FREE)
    np.testing.assert_allclose(other.coefficients * scales, one.coefficients, rtol=1e-6)


def test_intervals_hold_free_modes_and_others() -> None:
    inside = []
    for seed in range(60):
        rows, target, modes = made(0.5, seed)
        found = most_likely(rows, target, FREE)
        std = np.linalg.norm(found.root, axis=1)
        inside.append(np.abs(found.coefficients - modes) < 1.96 * std)
    assert 0.92 < np.mean(inside) < 0.98


def test_modes_that_are_not_there_are_nearly_zero() -> None:
    rows, target, modes = made(0.0, 1)
    found = most_likely(rows, target, FREE)
    std = np.linalg.norm(found.root, axis=1)
    assert np.abs(found.coefficients[FREE:]).max() < 0.1 * np.abs(modes).max() / 100.0
    assert (np.abs(found.coefficients[:FREE] - modes[:FREE]) < 4.0 * std[:FREE]).all()


def test_a_free_mode_that_no_datum_sees_stays_zero() -> None:
    rows, target, _ = made(0.5, 2)
    rows[:, 1] = 0.0
    found = most_likely(rows, target, FREE)
    assert np.isfinite(found.coefficients).all()
    assert found.coefficients[1] == 0.0
