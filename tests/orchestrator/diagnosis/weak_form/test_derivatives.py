"""Sums of the basis over samples from moments in each cell, against the splines at each sample."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.derivatives import sum_basis
from orchestrator.diagnosis.weak_form.windows import Windows, periodic_windows, plain_windows, sum_intervals
from orchestrator.numerics.tensor_spline import CARDINAL, EvenSpline, derivatives
from orchestrator.numerics.types import Array

GRID = EvenSpline(-3.0, 3.0, 3.0, (5, 6))
KINKED = EvenSpline(-3.0, 3.0, 3.0, (5, 6), kink=True)
OVERLAP = 0.08
"""How far t beyond its cell a polynomial is used: slopes part by 20 / 24 t^4, 2.2 t^4 of a spline's largest."""


def _current(n: int) -> Array:
    t = np.linspace(0.0, 1.0, n)
    return np.stack([2.5 * np.sin(6.0 * t), 1.5 * np.cos(9.0 * t) + 0.3 * np.sin(200.0 * t)], axis=1)


def _largest_slope(grid: EvenSpline = GRID) -> float:
    at = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))
    return float(max(np.abs(grid.rows(at, 1, 0)).max(), np.abs(grid.rows(at, 0, 1)).max()))


def _one_by_one(i_dq: Array, windows: Windows, turn: Array | float, grid: EvenSpline = GRID) -> Array:
    """The same sums from the basis' slopes at each sample."""
    slopes = np.stack([grid.rows(i_dq, 1, 0), grid.rows(i_dq, 0, 1)], axis=1)
    c, s = np.broadcast_arrays(np.cos(turn), np.sin(turn), np.zeros(len(i_dq)))[:2]
    steps = -np.diff(np.einsum("xyn,nyk->nxk", np.array([[c, -s], [s, c]]), slopes), axis=0)
    sums = [
        sum_intervals(
            np.ascontiguousarray(steps[:, :, k]), windows.step, windows.test_functions, windows.bins, windows.n_bins
        )
        for k in range(grid.size)
    ]
    return np.stack(sums, axis=-1)


@pytest.mark.parametrize("grid", [GRID, KINKED], ids=["smooth", "kinked"])
@pytest.mark.parametrize("windows", [plain_windows(1999, 160.0), periodic_windows(1999, 500.0, 20.0, 40)])
@pytest.mark.parametrize("turn", [0.0, 0.1, 0.1 + 0.05 * np.sin(np.arange(2000) / 7.0)])
def test_sums_from_moments_are_sums_over_samples(windows: Windows, turn: Array | float, grid: EvenSpline) -> None:
    i_dq = _current(2000)
    delta = np.full(2000, turn) if np.any(turn) else np.zeros(0)
    waves = (windows.step, windows.test_functions, windows.bins, windows.n_bins)
    sums = sum_basis(i_dq, delta, *waves, *grid.layout, CARDINAL, grid.kinked)
    expected = _one_by_one(i_dq, windows, turn, grid)
    np.testing.assert_allclose(sums, expected, atol=2.2 * OVERLAP**4 * _largest_slope(grid))


def test_without_overlap_hardly_anything_is_left() -> None:
    i_dq, windows = _current(1000), plain_windows(999, 100.0)
    assert windows is not None
    numbers, counts = GRID.layout
    args = (
        i_dq,
        np.zeros(0),
        windows.step,
        windows.test_functions,
        windows.bins,
        windows.n_bins,
        numbers,
        counts,
        CARDINAL,
        GRID.kinked,
    )
    expected = _one_by_one(i_dq, windows, 0.0)
    # All but the half of an interval that ends in the next cell.
    np.testing.assert_allclose(sum_basis(*args, 0.0), expected, atol=2e-6 * _largest_slope())


def test_beyond_the_map_the_sums_follow_its_slopes_that_go_on_linearly() -> None:
    """Beyond one edge at a time: in a corner the kernel leaves out the term that bends along both."""
    t = np.linspace(0.0, 1.0, 2000)[:, None]
    windows = plain_windows(1999, 160.0)
    assert windows is not None
    numbers, counts = GRID.layout
    c = np.random.default_rng(2).normal(size=GRID.size)
    for centre in ([3.2, 0.5], [-3.2, 0.5], [0.5, 3.2]):
        i_dq = np.array(centre) + 0.5 * np.concatenate([np.sin(6.0 * t), np.cos(9.0 * t)], axis=1) * [1.0, 0.3]
        i_dq = i_dq if centre[0] != 0.5 else i_dq[:, ::-1] + [-2.7, 2.7]
        steps = np.ascontiguousarray(-np.diff(derivatives(i_dq, GRID.patches(c), numbers)[0], axis=0))
        expected = sum_intervals(steps, windows.step, windows.test_functions, windows.bins, windows.n_bins)
        sums = sum_basis(
            i_dq,
            np.zeros(0),
            windows.step,
            windows.test_functions,
            windows.bins,
            windows.n_bins,
            numbers,
            counts,
            CARDINAL,
            GRID.kinked,
        )
        atol = 2.2 * OVERLAP**4 * _largest_slope() * float(np.abs(c).sum())
        np.testing.assert_allclose(sums @ c, expected, atol=atol)
        assert float(np.abs(expected).max()) > 20.0 * atol
