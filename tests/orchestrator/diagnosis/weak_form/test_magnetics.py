"""The co-energy's flux and inductance, against what a co-energy implies."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.magnetics import Magnetics, linear_magnetics, smoothness_prior
from orchestrator.numerics.tensor_spline import EvenSpline
from tests.support.close import assert_close

GRID = EvenSpline(-3.0, 4.0, 3.5, (6, 6))


def _random_map() -> Magnetics:
    rng = np.random.default_rng(1)
    linear = linear_magnetics(GRID, 0.043, 0.069)
    return Magnetics(GRID, linear.coefficients + rng.normal(0.0, 1e-4, GRID.size))


def test_linear_map_has_constant_inductances_inside_and_outside() -> None:
    i = np.random.default_rng(2).uniform(-6.0, 6.0, (200, 2))
    psi, inductance = linear_magnetics(GRID, 0.043, 0.069).flux_and_inductance(i)
    assert_close(psi, i * [0.043, 0.069], 1e-12)
    assert_close(inductance, np.tile([0.043, 0.0, 0.069], (200, 1)), 1e-12)


def test_inductance_is_the_derivative_of_the_flux() -> None:
    model, h = _random_map(), 1e-6
    i = np.random.default_rng(3).uniform(-2.5, 3.0, (50, 2))
    _, inductance = model.flux_and_inductance(i)
    for axis, columns in ((0, (0, 1)), (1, (1, 2))):
        step = np.zeros(2)
        step[axis] = h
        slope = (model.flux_and_inductance(i + step)[0] - model.flux_and_inductance(i - step)[0]) / (2 * h)
        assert_close(slope, inductance[:, columns], 1e-6)


def test_map_is_even_in_i_q() -> None:
    model = _random_map()
    i = np.random.default_rng(4).uniform(-3.0, 3.0, (50, 2))
    psi, _ = model.flux_and_inductance(i)
    mirrored, _ = model.flux_and_inductance(i * [1.0, -1.0])
    assert_close(mirrored, psi * [1.0, -1.0], 1e-12)


def test_reciprocity_holds_for_any_coefficients() -> None:
    model, h = _random_map(), 1e-6
    i = np.random.default_rng(5).uniform(-2.5, 3.0, (50, 2))
    along_d, along_q = (
        model.flux_and_inductance(i + step)[0] - model.flux_and_inductance(i - step)[0] for step in h * np.eye(2)
    )
    d_by_q, q_by_d = along_q[:, 0], along_d[:, 1]
    assert_close(d_by_q, q_by_d, 1e-6)


def test_flux_is_linear_in_the_coefficients() -> None:
    one, other = _random_map(), linear_magnetics(GRID, 0.1, 0.2)
    i = np.random.default_rng(6).uniform(-4.0, 5.0, (50, 2))
    both = Magnetics(GRID, 2.0 * one.coefficients - other.coefficients).flux_and_inductance(i)
    for part, a, b in zip(both, one.flux_and_inductance(i), other.flux_and_inductance(i), strict=True):
        assert_close(part, 2.0 * a - b, 1e-12)


def test_a_finer_grid_holds_the_same_map() -> None:
    model = linear_magnetics(GRID, 0.043, 0.069)
    i = np.random.default_rng(7).uniform(-2.9, 3.4, (50, 2))
    finer = model.on(EvenSpline(GRID.low, GRID.high, GRID.reach, (9, 10)))
    for before, after in zip(model.flux_and_inductance(i), finer.flux_and_inductance(i), strict=True):
        assert_close(after, before, 1e-11)


@pytest.mark.parametrize("cells", [(6, 6), (10, 10)])
def test_prior_does_not_mind_linear_maps_and_costs_a_bend_alike_on_every_grid(cells: tuple[int, int]) -> None:
    grid = EvenSpline(-3.0, 3.0, 3.0, cells)
    prior = smoothness_prior(grid, 0.05, 3.0, 3.0)
    linear = linear_magnetics(grid, 0.05, 0.05)
    assert float(np.square(prior @ linear.coefficients).sum()) < 1e-4
    # W = c i_d^4 has one fourth derivative only, 24 c, the same everywhere: as much as 25 independent ones.
    at = np.random.default_rng(8).uniform(-3.0, 3.0, (600, 2))
    quartic = np.linalg.lstsq(grid.rows(at, 0, 0), at[:, 0] ** 4, rcond=None)[0]
    sigma = 3.0 * 0.05 / 3.0**2
    assert float(np.square(prior @ quartic).sum()) == pytest.approx(25.0 * (24.0 / sigma) ** 2, rel=0.01)
