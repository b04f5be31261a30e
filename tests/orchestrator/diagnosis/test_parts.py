"""The parts of the weak form, each against what defines it."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.magnetics import Magnetics, linear_magnetics
from orchestrator.diagnosis.weak_form.windows import periodic_windows, plain_windows, sum_intervals
from orchestrator.numerics.tensor_spline import EvenSpline

GRID = EvenSpline(-3.0, 4.0, 3.5, (6, 6))


def _random_map() -> Magnetics:
    rng = np.random.default_rng(1)
    linear = linear_magnetics(GRID, 0.043, 0.069)
    return Magnetics(GRID, linear.coefficients + rng.normal(0.0, 1e-4, GRID.size))


def test_linear_map_has_constant_inductances_inside_and_outside() -> None:
    i = np.random.default_rng(2).uniform(-6.0, 6.0, (200, 2))
    psi, inductance = linear_magnetics(GRID, 0.043, 0.069).flux_and_inductance(i)
    np.testing.assert_allclose(psi, i * [0.043, 0.069], atol=1e-13)
    np.testing.assert_allclose(inductance, np.tile([0.043, 0.0, 0.069], (200, 1)), atol=1e-13)


def test_inductance_is_the_derivative_of_the_flux() -> None:
    model, h = _random_map(), 1e-6
    i = np.random.default_rng(3).uniform(-2.5, 3.0, (50, 2))
    _, inductance = model.flux_and_inductance(i)
    for axis, columns in ((0, (0, 1)), (1, (1, 2))):
        step = np.zeros(2)
        step[axis] = h
        slope = (model.flux_and_inductance(i + step)[0] - model.flux_and_inductance(i - step)[0]) / (2 * h)
        np.testing.assert_allclose(slope, inductance[:, columns], rtol=1e-6, atol=1e-9)


def test_map_is_even_in_i_q() -> None:
    model = _random_map()
    i = np.random.default_rng(4).uniform(-3.0, 3.0, (50, 2))
    psi, _ = model.flux_and_inductance(i)
    mirrored, _ = model.flux_and_inductance(i * [1.0, -1.0])
    np.testing.assert_allclose(mirrored, psi * [1.0, -1.0], atol=1e-15)


def test_hats_add_up_to_one_between_the_first_and_the_last() -> None:
    windows = plain_windows(1000, 100.0)
    assert windows is not None
    x = np.zeros((1000, 2))
    x[450:460, 0] = 1.0
    sums = windows.combine(sum_intervals(x, windows.step, windows.hats, windows.bins, windows.n_bins))
    assert sums.reshape(-1, 2)[:, 0].sum() == pytest.approx(10.0)


def test_carriers_see_only_their_own_harmonic() -> None:
    windows = periodic_windows(4000, 1000.0, 20.0)
    assert windows is not None
    k = np.arange(4000) + 0.5
    x = np.stack([np.cos(2 * np.pi * 3 * k / 20.0), np.zeros(4000)], axis=1)
    sums = windows.combine(sum_intervals(x, windows.step, windows.hats, windows.bins, windows.n_bins))
    size = np.abs(sums.reshape(windows.hats, len(windows.carriers), 2)[:, :, 0]).max(axis=0)
    # Order: 0, then cosine and sine of 1, 2, 3, 5.
    assert size[5] == pytest.approx(500.0, rel=1e-3)
    assert np.delete(size, 5).max() < 1.0


def test_too_short_a_segment_has_no_window() -> None:
    assert plain_windows(100, 100.0) is None
