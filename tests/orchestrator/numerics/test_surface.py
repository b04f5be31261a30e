from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.surface import SmoothSurface, TaylorSurface, current_axes, inside_hull
from protocols import NotMeasuredError
from tests.orchestrator.analysis.plant import Array
from tests.support.close import assert_close

RANDOM = np.random.default_rng(5)
SCATTER = np.concatenate([RANDOM.uniform(-1, 1, (40, 2)), [[-1, -1], [1, -1], [-1, 1], [1, 1]]])
PLACES = RANDOM.uniform(-0.9, 0.9, (50, 2))


def cubic(x: Array) -> tuple[Array, Array, Array]:
    """A cubic polynomial with its first and second derivatives."""
    a, b = x.T
    value = 1 + a - 2 * b + a * b + a**2 + 3 * a**3 - 2 * a**2 * b + b**3
    gradient = np.stack([1 + b + 2 * a + 9 * a**2 - 4 * a * b, -2 + a - 2 * a**2 + 3 * b**2], axis=1)
    second = np.stack([np.stack([2 + 18 * a - 4 * b, 1 - 4 * a], -1), np.stack([1 - 4 * a, 6 * b], -1)], -1)
    return value, gradient, second


def test_values_slopes_and_curvatures_reproduce_cubics() -> None:
    surface = TaylorSurface(SCATTER, PLACES, "test")
    assert_close(surface(*cubic(SCATTER)), cubic(PLACES)[0], 1e-12)


def test_values_and_slopes_reproduce_quadratics() -> None:
    surface = TaylorSurface(SCATTER, PLACES, "test")
    d, q = SCATTER.T
    x, y = PLACES.T
    slopes = np.stack([2 * d + q, d - 4 * q], axis=1)
    assert_close(surface(d**2 + d * q - 2 * q**2, slopes), x**2 + x * y - 2 * y**2, 1e-12)


THIN = 1e-3
NEARLY_IN_LINE = np.array([[0.0, 0.0], [1.0, THIN], [4.0, 0.0], [1.0, 3.0]])
IN_THE_SPLINTER = np.array([[0.5, 0.4 * THIN], [1.0, 0.5 * THIN], [2.0, 0.3 * THIN]])


def test_a_splinter_along_the_hull_reproduces_planes() -> None:
    surface = TaylorSurface(NEARLY_IN_LINE, IN_THE_SPLINTER, "test")
    assert surface.is_sliver.all()
    slope = np.array([2.0, -30.0])
    found = surface(NEARLY_IN_LINE @ slope, np.tile(slope, (4, 1)))
    assert_close(found, IN_THE_SPLINTER @ slope, 1e-12)


def test_the_far_end_of_a_splinter_says_nothing_of_what_is_between_the_other_two() -> None:
    surface = TaylorSurface(NEARLY_IN_LINE, IN_THE_SPLINTER, "test")
    far = np.array([0.0, 0.0, 1e6, 0.0])
    found = surface(far, np.zeros((4, 2)))
    assert_close(found[:1], np.zeros(1), 1.0)
    assert found[2] == pytest.approx(1e6 / 3.0, rel=1e-3)


def test_nothing_is_stated_outside_the_hull() -> None:
    surface = TaylorSurface(SCATTER, np.array([[0.0, 0.0], [1.2, 0.0], [0.0, -3.0]]), "test")
    np.testing.assert_array_equal(np.isnan(surface(SCATTER[:, 0])), [False, True, True])


def test_points_in_line_span_nothing() -> None:
    with pytest.raises(NotMeasuredError, match="span"):
        TaylorSurface(np.stack([np.arange(5.0), np.zeros(5)], axis=1), PLACES, "test")


def test_smooth_surface_converges_with_its_slopes() -> None:
    errors = []
    for n in (9, 17):
        grid = np.stack(np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n)), axis=-1).reshape(-1, 2)
        surface = SmoothSurface(grid, np.sin(grid[:, :1]) * grid[:, 1:])
        x, y = 0.7 * PLACES.T
        value, slope = surface(0.7 * PLACES)[:, 0], surface.gradient(0.7 * PLACES)[:, 0]
        truth = np.stack([np.cos(x) * y, np.sin(x)], axis=1)
        errors.append([np.abs(value - np.sin(x) * y).max(), np.abs(slope - truth).max()])
    assert errors[0][0] < 2e-3
    assert errors[0][0] > 4 * errors[1][0]
    assert errors[0][1] > 2 * errors[1][1]


@pytest.mark.parametrize("size", [0.7, 3.0, 7.5, 145.0])
def test_axes_are_round_hold_zero_and_stay_within(size: float) -> None:
    i_d, i_q = current_axes(np.array([[-size, -size], [size, size], [0.3 * size, 0.9 * size]]))
    for axis in (i_d, i_q):
        assert np.abs(axis).min() < 1e-9 * size
        assert abs(axis[0]) <= size * (1 + 1e-9)
        assert abs(axis[-1]) <= size * (1 + 1e-9)
        assert 25 < len(axis) < 70
        assert abs(axis[0]) > 0.95 * size


def test_hull_is_convex() -> None:
    np.testing.assert_array_equal(inside_hull(SCATTER, np.array([[0.99, 0.99], [1.01, 0.0]]), "test"), [True, False])
