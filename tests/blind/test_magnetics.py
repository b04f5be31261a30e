"""The blind machines: saturated, reciprocal, even in i_q unless slots say otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.magnetics import PM400, POINTS, REACH, TRACTION_28KW, Table, draw_table, tabulated
from tests.support.close import assert_close

FAMILIES = ("froehlich", "langevin", "arctan", "measured")


@pytest.fixture(params=FAMILIES)
def table(request: pytest.FixtureRequest) -> Table:
    return draw_table(np.random.default_rng(11), PM400, family=request.param)[1]


def test_inductances_are_the_slopes_of_the_flux(table: Table) -> None:
    h = 1e-4
    for i_d, i_q in ((0.3, 0.4), (-2.7, 1.9), (3.1, -2.2)):
        dd, dq, qq = table.inductance(i_d, i_q)
        slope_d = np.subtract(table.flux(i_d + h, i_q), table.flux(i_d - h, i_q)) / (2 * h)
        slope_q = np.subtract(table.flux(i_d, i_q + h), table.flux(i_d, i_q - h)) / (2 * h)
        assert_close(slope_d, [dd, dq], 1e-5)
        assert_close(slope_q, [dq, qq], 1e-5)


def test_flux_is_even_in_i_q_and_the_magnets_at_zero(table: Table) -> None:
    d, q = table.flux(1.3, 2.1)
    assert_close(table.flux(1.3, -2.1), (d, -q), 1e-9)
    assert_close(table.flux(0.0, 0.0), (PM400.pm_flux_wb, 0.0), 6e-4)


def test_machines_saturate_across_and_along(table: Table) -> None:
    top = PM400.top_a
    d, _, q = table.inductance(0.0, 0.0)
    assert table.inductance(top, 0.0)[0] < 0.95 * d
    assert table.inductance(0.0, top)[2] < 0.85 * q
    assert abs(table.inductance(0.6 * top, 0.6 * top)[1]) > 0.002 * d


def test_slots_break_the_evenness() -> None:
    _, table = draw_table(np.random.default_rng(3), PM400, slot=0.03, family="langevin")
    assert abs(table.inductance(0.0, 0.0)[1]) > 1e-4


def test_other_motors_have_their_own_scale() -> None:
    _, table = draw_table(np.random.default_rng(3), TRACTION_28KW, family="arctan")
    assert table.inductance(0.0, 0.0)[0] == pytest.approx(TRACTION_28KW.l_d_h, rel=0.1)


def test_a_quadratic_energy_is_reproduced_exactly() -> None:
    axis = np.linspace(-REACH, REACH, POINTS) * 3.0
    x, y = np.meshgrid(axis, axis, indexing="ij")
    table = tabulated(0.5 * 0.04 * x**2 + 0.5 * 0.07 * y**2 + 0.01 * x * y, axis)
    assert table.inductance(1.1, -0.7) == pytest.approx((0.04, 0.01, 0.07), rel=1e-4)
