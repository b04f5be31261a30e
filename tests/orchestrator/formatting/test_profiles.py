"""Lines through a flux map are the map's own numbers, and nothing is made up beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.formatting.profiles import flux_at_zero, profile
from tests.plugins.streams.example_run import a_map


def test_profile_along_a_grid_line_is_the_map_s_own() -> None:
    found = a_map("injection")
    current, flux, std = profile(found, "psi_d", "d", 0.0)
    middle = len(found.i_q) // 2
    assert np.array_equal(current, found.i_d)
    assert np.array_equal(flux, found.psi_d[:, middle])
    assert np.array_equal(std, found.psi_d_std[:, middle])


def test_profile_between_grid_lines_is_linear_and_outside_unknown() -> None:
    found = a_map("injection")
    _, flux, _ = profile(found, "psi_q", "q", 0.25)
    at = int(np.searchsorted(found.i_d, 0.0))
    assert flux[6] == pytest.approx((found.psi_q[at, 6] + found.psi_q[at + 1, 6]) / 2)
    assert np.isnan(profile(found, "psi_q", "q", 9.0)[1]).all()


def test_flux_at_zero_current_is_the_map_s_own() -> None:
    found = a_map("injection")
    assert flux_at_zero(found) == pytest.approx({"d": 0.3, "q": 0.0}, abs=1e-12 * 0.3)


def test_a_map_that_does_not_reach_zero_counts_from_nothing() -> None:
    found = a_map("injection")
    beside = {"i_d": found.i_d + 10.0}
    assert flux_at_zero(found.model_copy(update=beside)) == {"d": 0.0, "q": 0.0}
