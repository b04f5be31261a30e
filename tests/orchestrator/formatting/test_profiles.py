"""Lines through a flux map are the map's own numbers, and nothing is extrapolated."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.formatting.profiles import flux_at_zero, profile
from tests.plugins.streams.example_run import a_map


def test_profile_along_a_grid_line_is_the_map_s_own() -> None:
    flux_map = a_map("injection")
    current, flux, std = profile(flux_map, "psi_d", "d", 0.0)
    middle = len(flux_map.i_q) // 2
    assert np.array_equal(current, flux_map.i_d)
    assert np.array_equal(flux, flux_map.psi_d[:, middle])
    assert np.array_equal(std, flux_map.psi_d_std[:, middle])


def test_profile_between_grid_lines_is_linear_and_outside_unknown() -> None:
    flux_map = a_map("injection")
    _, flux, _ = profile(flux_map, "psi_q", "q", 0.25)
    at = int(np.searchsorted(flux_map.i_d, 0.0))
    assert flux[6] == pytest.approx((flux_map.psi_q[at, 6] + flux_map.psi_q[at + 1, 6]) / 2)
    assert np.isnan(profile(flux_map, "psi_q", "q", 9.0)[1]).all()


def test_flux_at_zero_current_is_the_map_s_own() -> None:
    flux_map = a_map("injection")
    assert flux_at_zero(flux_map) == pytest.approx({"d": 0.3, "q": 0.0}, abs=1e-12 * 0.3)


def test_a_map_that_does_not_reach_zero_counts_from_nothing() -> None:
    flux_map = a_map("injection")
    beside = {"i_d": flux_map.i_d + 10.0}
    assert flux_at_zero(flux_map.model_copy(update=beside)) == {"d": 0.0, "q": 0.0}
