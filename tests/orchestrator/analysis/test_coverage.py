"""Stated 95 % intervals hold the truth about as often as they say, and are no wider than they need be."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.coverage import QUANTITIES, SCENARIOS, Coverage, cover, together

PSI_D = QUANTITIES.index("psi_d")
OTHERS = slice(PSI_D + 1, QUANTITIES.index("R_s"))


@pytest.fixture(scope="module")
def found() -> dict[str, Coverage]:
    """Eight runs of each scenario."""
    return {name: cover(name, 8) for name in SCENARIOS}


@pytest.mark.slow
def test_intervals_hold_the_truth_and_are_not_vacuous(found: dict[str, Coverage]) -> None:
    reported = "\n".join(f"{name}: {coverage}" for name, coverage in found.items())
    every = together(found.values())
    maps = slice(0, QUANTITIES.index("R_s"))
    assert (every.share[maps] > 0.90).all(), reported
    assert (every.share[OTHERS] < 0.99).all(), reported
    # Of so few runs a share of 95 % may show as a little less.
    assert every.share[QUANTITIES.index("R_s")] > 0.9, reported
    for coverage in found.values():
        assert (coverage.share[maps] > 0.85).all(), reported
        # Neither too good to be true nor too wide to be of use.
        assert (coverage.width_over_error[maps] > 0.4).all(), reported
        assert (coverage.width_over_error[maps] < 3.0).all(), reported


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="99.1 %: errors that are smaller than stated are not believed, decision 14")
def test_intervals_of_the_d_axis_flux_are_no_wider_than_need_be(found: dict[str, Coverage]) -> None:
    assert together(found.values()).share[PSI_D] < 0.99


@pytest.mark.slow
def test_an_interval_that_is_ten_times_too_wide_or_too_narrow_shows() -> None:
    honest = cover("cold", 1)
    maps = slice(0, QUANTITIES.index("R_s"))
    assert (honest.width_over_error[maps] < 5.0).all()
    assert (honest.width_over_error[maps] > 0.2).all()
    assert np.isfinite(honest.error).all()
    assert 0.0 < honest.flux_percent < 0.1
