from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.tensor_spline import EvenSpline, derivatives
from tests.orchestrator.analysis.plant import Array
from tests.support.close import assert_close

RANDOM = np.random.default_rng(3)
AT = RANDOM.uniform(-1.9, 1.9, (60, 2))


EVERYWHERE = RANDOM.uniform((-3.0, -4.0), (2.0, 4.0), (600, 2))


def fitted(spline: EvenSpline, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(spline.rows(EVERYWHERE, 0, 0), values, rcond=None)[0])


@pytest.mark.parametrize("cells", [(7, 8), (4, 5)])
def test_the_function_is_even_and_its_derivatives_are_its_own(cells: tuple[int, int]) -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, cells)
    c = RANDOM.normal(size=spline.size)
    mirrored = AT * np.array([1.0, -1.0])
    assert_close(spline.rows(AT, 0, 0) @ c, spline.rows(mirrored, 0, 0) @ c, 1e-12)
    assert_close(spline.rows(AT, 1, 1) @ c, -spline.rows(mirrored, 1, 1) @ c, 1e-12)
    for m, n in ((0, 0), (1, 1), (0, 2)):
        for step, order in ((np.array([1e-4, 0.0]), (m + 1, n)), (np.array([0.0, 1e-4]), (m, n + 1))):
            slope = (spline.rows(AT + step, m, n) - spline.rows(AT - step, m, n)) @ c / 2e-4
            assert_close(spline.rows(AT, *order) @ c, slope, 1e-6)


def test_polynomials_that_are_even_and_of_low_degree_have_no_roughness() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (3, 4))
    x, y = EVERYWHERE.T
    eigenvalues = np.linalg.eigvalsh(spline.roughness)
    assert (eigenvalues[: spline.smooth] < 1e-9 * eigenvalues[-1]).all()
    assert eigenvalues[spline.smooth] > 1e-9 * eigenvalues[-1]
    quartic = fitted(spline, 1.0 + x - x**3 * 2 + x**2 * y**2 + y**4)
    assert abs(quartic @ spline.roughness @ quartic) < 1e-12 * eigenvalues[-1] * (quartic @ quartic)


def test_roughness_is_the_integral_of_the_squared_fifth_derivatives() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (3, 4))
    x, y = EVERYWHERE.T
    # In units of the half ranges 2.5 and 4 the rectangle is 2 by 2; x y^4 has one kind of fifth derivative, five times.
    for values, fifth, times in ((x**5, 120.0 * 2.5**5, 1), (x * y**4, 24.0 * 2.5 * 4.0**4, 5)):
        c = fitted(spline, values)
        assert c @ spline.roughness @ c == pytest.approx(4.0 * times * fifth**2, rel=1e-6)


def test_roughness_does_not_depend_on_the_unit() -> None:
    one, other = EvenSpline(-3.0, 2.0, 4.0, (3, 4)), EvenSpline(-3000.0, 2000.0, 4000.0, (3, 4))
    assert_close(other.roughness, one.roughness, 1e-6)


def test_patches_are_the_function_and_its_slopes_go_on_linearly_beyond_the_rectangle() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (4, 5))
    c = RANDOM.normal(size=spline.size)
    slopes, curvatures = derivatives(AT, spline.patches(c), spline.layout[0])
    orders = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    expected = np.stack([spline.rows(AT, *order) @ c for order in orders], axis=1)
    assert_close(np.hstack([slopes, curvatures]), expected, 1e-9)
    edge, out = np.array([[2.0, 1.0]]), np.array([[3.5, 1.0]])
    (at_edge, bend), (beyond, _) = (derivatives(x, spline.patches(c), spline.layout[0]) for x in (edge, out))
    assert_close(beyond, at_edge + 1.5 * bend[:, :2], 1e-12)


def test_squares_are_exact() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (4, 5))
    for c, values in zip(spline.squares(), EVERYWHERE.T**2, strict=True):
        assert_close(spline.rows(EVERYWHERE, 0, 0) @ c, values, 1e-12)


def test_what_a_coarse_spline_is_a_finer_one_over_the_same_cells_is_too() -> None:
    coarse, fine = EvenSpline(-3.0, 2.0, 4.0, (3, 4)), EvenSpline(-3.0, 2.0, 4.0, (6, 8))
    c = RANDOM.normal(size=coarse.size)
    expected = coarse.rows(EVERYWHERE, 0, 0) @ c
    assert_close(fine.rows(EVERYWHERE, 0, 0) @ coarse.on(fine, c), expected, 1e-11, of=c)


def test_on_a_wider_rectangle_it_is_as_it_was_and_goes_on_as_a_parabola() -> None:
    own, wider = EvenSpline(-3.0, 2.0, 4.0, (3, 4)), EvenSpline(-4.0, 3.0, 5.0, (60, 80))
    c = own.squares()[0] + 0.1 * RANDOM.normal(size=own.size)
    on_wider = own.on(wider, c)
    inside = EVERYWHERE * 0.9
    assert_close(wider.rows(inside, 0, 0) @ on_wider, own.rows(inside, 0, 0) @ c, 1e-4, of=c)
    edge, beyond = np.array([[2.0, 1.0]]), np.array([[2.8, 1.0]])
    value, slope, bend = (own.rows(edge, order, 0) @ c for order in range(3))
    assert_close(wider.rows(beyond, 0, 0) @ on_wider, value + 0.8 * slope + 0.32 * bend, 1e-4, of=c)


def test_differences_of_the_coefficients_are_mixed_derivatives() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (4, 6))
    x_squared, y_squared = spline.squares()
    pure, *_, other = spline.differences(2)
    for rows, coefficients, second in ((pure, x_squared, 2.0), (other, y_squared, 2.0), (other, x_squared, 0.0)):
        found = rows @ coefficients
        assert_close(found, np.full_like(found, second), 1e-11, of=2.0)


def test_a_kink_is_a_jump_of_the_third_derivative_at_zero_and_nowhere_else() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (7, 8), kink=True)
    c = np.zeros(spline.functions)
    c[:, -1] = 1.0
    y = np.array([-3.7, -2.1, -1.2, -0.3, -1e-9, 1e-9, 0.3, 1.2, 2.1, 3.7])
    third = spline.rows(np.column_stack([np.zeros_like(y), y]), 0, 3) @ c.reshape(-1)
    assert third[5] == pytest.approx(6.0)
    assert_close(third, -third[::-1], 1e-9)
    # Beyond two cells on either side there is nothing of it.
    assert_close(third[[0, 1, 8, 9]], np.zeros(4), 1e-9, of=third)
    step = 1e-7
    for edge, order in ((0.0, 2), (1.0, 4), (2.0, 4)):
        ends = [spline.rows(np.array([[0.0, edge + side]]), 0, order) @ c.reshape(-1) for side in (-step, step)]
        assert_close(ends[0], ends[1], 1e-6, of=third)


def test_with_a_kink_patches_derivatives_and_finer_grids_are_still_the_function() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (7, 8), kink=True)
    c = RANDOM.normal(size=spline.size)
    slopes, curvatures = derivatives(AT, spline.patches(c), spline.layout[0])
    expected = np.stack([spline.rows(AT, 1, 0) @ c, spline.rows(AT, 0, 1) @ c], axis=1)
    assert_close(slopes, expected, 1e-12)
    assert_close(curvatures[:, 2], spline.rows(AT, 0, 2) @ c, 1e-11)
    finer = EvenSpline(-3.0, 2.0, 4.0, (14, 16), kink=True)
    assert_close(finer.rows(AT, 0, 2) @ spline.on(finer, c), spline.rows(AT, 0, 2) @ c, 1e-9)


def test_without_one_a_function_is_the_same_on_a_grid_with_a_kink() -> None:
    smooth, kinked = (EvenSpline(-3.0, 2.0, 4.0, (7, 8), kink=kink) for kink in (False, True))
    c = RANDOM.normal(size=smooth.size)
    same = smooth.on(kinked, c)
    assert_close(same.reshape(kinked.functions)[:, -1], np.zeros(kinked.functions[0]), 1e-10, of=same)
    assert_close(kinked.rows(AT, 1, 1) @ same, smooth.rows(AT, 1, 1) @ c, 1e-10)
    x_squared, y_squared = kinked.squares()
    assert_close(kinked.rows(AT, 2, 0) @ x_squared, np.full(len(AT), 2.0), 1e-10)
    assert_close(kinked.rows(AT, 0, 2) @ y_squared, np.full(len(AT), 2.0), 1e-10)


@pytest.mark.parametrize("cells", [(7, 7), (7, 2)])
def test_a_kink_needs_a_node_at_zero_and_two_intervals_on_either_side(cells: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="even number of 4 or more intervals"):
        EvenSpline(-3.0, 2.0, 4.0, cells, kink=True)
    with pytest.raises(ValueError, match="without a kink"):
        _ = EvenSpline(-3.0, 2.0, 4.0, (7, 8), kink=True).roughness
