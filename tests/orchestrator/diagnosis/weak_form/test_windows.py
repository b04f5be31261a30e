"""Windows: test functions that add up to one, and modes that respond to their own harmonic only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.windows import (
    Windows,
    function_weights,
    periodic_windows,
    plain_windows,
    sum_intervals,
)
from orchestrator.numerics.types import Array


def _sums(windows: Windows, x: Array) -> Array:
    return windows.combine(sum_intervals(x, windows.step, windows.test_functions, windows.bins, windows.n_bins))


def test_hats_add_up_to_one_between_the_first_and_the_last() -> None:
    windows = plain_windows(1000, 100.0)
    assert windows is not None
    x = np.zeros((1000, 2))
    x[450:460, 0] = 1.0
    sums = _sums(windows, x)
    assert sums.reshape(-1, 2)[:, 0].sum() == pytest.approx(10.0)


def test_carriers_see_only_their_own_harmonic() -> None:
    windows = periodic_windows(4000, 1000.0, 20.0, 40)
    assert windows is not None
    k = np.arange(4000) + 0.5
    x = np.stack([np.cos(2 * np.pi * 3 * k / 20.0), np.zeros(4000)], axis=1)
    sums = _sums(windows, x)
    size = np.abs(sums.reshape(windows.test_functions, len(windows.modes), 2)[:, :, 0]).max(axis=0)
    # Order: 0, then cosine and sine of 1, 2, 3, 5.
    assert size[5] == pytest.approx(500.0, rel=1e-3)
    assert np.delete(size, 5).max() < 1.0


def test_too_short_a_segment_has_no_window() -> None:
    assert plain_windows(100, 100.0) is None


@pytest.mark.parametrize("step", [100.0, 37.3])
def test_hats_partition_unity_between_their_peaks(step: float) -> None:
    windows = plain_windows(1000, step)
    assert windows is not None
    total = np.zeros(1000)
    for k in range(1000):
        _, before, after = function_weights(k, step, windows.test_functions)
        total[k] = before + after
    inside = slice(int(step) + 1, int(windows.test_functions * step) - 1)
    np.testing.assert_allclose(total[inside], 1.0, rtol=1e-12)


def test_a_row_over_its_absolute_weight_is_a_mean() -> None:
    constant = np.full((4000, 2), 3.0)
    plain, periodic = plain_windows(4000, 250.0), periodic_windows(4000, 500.0, 20.0, 40)
    assert plain is not None
    assert periodic is not None
    np.testing.assert_allclose(_sums(plain, constant) / plain.absolute_weight, 3.0, rtol=1e-3)
    means = (_sums(periodic, constant) / periodic.absolute_weight).reshape(periodic.test_functions, -1, 2)[:, 0]
    np.testing.assert_allclose(means, 3.0, rtol=1e-3)


def test_sums_do_not_depend_on_where_a_column_stands() -> None:
    windows = periodic_windows(3000, 600.0, 16.0, 40)
    assert windows is not None
    sums = np.random.default_rng(1).normal(size=(windows.test_functions, windows.n_bins, 2, 3))
    rows = windows.combine(sums)
    assert rows.shape == (windows.rows, 3)
    for column in range(3):
        np.testing.assert_array_equal(windows.combine(np.ascontiguousarray(sums[..., column])), rows[:, column])


def test_modes_that_a_period_cannot_show_are_left_out() -> None:
    windows = periodic_windows(1000, 200.0, 6.0, 40)
    assert windows is not None
    assert windows.orders == (0, 1, 1, 2, 2)
    assert len(windows.modes) == len(windows.orders)


@pytest.mark.parametrize("unread", [0, 1])
def test_an_axis_that_nobody_read_says_nothing(unread: int) -> None:
    whole = periodic_windows(4000, 1000.0, 20.0, 40)
    assert whole is not None
    windows = replace(whole, unread=unread)
    x = np.random.default_rng(3).normal(size=(4000, 2))
    reported, every = (_sums(one, x).reshape(-1, 2) for one in (windows, whole))
    assert not reported[:, unread].any()
    np.testing.assert_array_equal(reported[:, 1 - unread], every[:, 1 - unread])
    assert 2 * windows.informative == windows.rows == whole.informative
