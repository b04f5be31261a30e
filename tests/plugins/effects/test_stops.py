"""Vector stops: what they hold, and that they never give back more than they took."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.frames import rotation
from orchestrator.numerics.types import Array
from plugins.effects._stops import Course, stops, yields_of

LIMITS = np.array([0.3, 0.7])
STIFFNESS = np.array([2.0, 1.0])
NOTHING = np.zeros((2, 2))
SOFTNESSES = [0.0, 0.05, 0.6, 3.0]


def held(course: Array, softness: float, before: int = 0, giving: float = 0.0, off: Array = NOTHING) -> Array:
    return np.asarray(stops(_course(course, before), STIFFNESS, LIMITS, yields_of(softness), giving, off[None]))


def _course(course: Array, before: int = 0) -> Course:
    """One segment's, whose first `before` values were before."""
    ways, values = course[:before], course[before:]
    return Course(values, np.array([0, len(values)]), ways, np.array([0, before]))


def a_walk(seed: int, count: int = 400) -> Array:
    """Some way about the plane in small steps, and back to where it began."""
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.03, (count, 2)), axis=0)
    return np.asarray(np.concatenate([walk, np.linspace(walk[-1], walk[0], count)]))


def test_until_they_yield_sharp_stops_hold_what_their_course_has_gone() -> None:
    course = np.linspace([1.0, 2.0], [1.1, 2.05], 50)
    np.testing.assert_allclose(held(course, 0.0), STIFFNESS.sum() * (course - course[0]), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("softness", SOFTNESSES)
def test_far_along_a_line_they_hold_their_limits(softness: float) -> None:
    end = held(np.linspace([0.0, 0.0], [15.0, 20.0], 50_000), softness)[-1]
    np.testing.assert_allclose(end, LIMITS.sum() * np.array([0.6, 0.8]), rtol=2e-3)


@pytest.mark.parametrize("softness", SOFTNESSES)
@given(seed=st.integers(0, 2**31))
def test_they_hold_no_more_than_their_limits(softness: float, seed: int) -> None:
    assert np.linalg.norm(held(a_walk(seed), softness), axis=1).max() <= LIMITS.sum() * (1.0 + 1e-12)


@pytest.mark.parametrize("softness", SOFTNESSES)
@given(seed=st.integers(0, 2**31))
def test_what_they_take_on_a_way_and_back_again_and_again_they_do_not_give_back(softness: float, seed: int) -> None:
    walk = a_walk(seed)
    rounds = held(np.concatenate([walk, walk, walk]), softness)[-len(walk) :]
    middle = 0.5 * (rounds[1:] + rounds[:-1])
    assert float(np.einsum("ij,ij->", middle, np.diff(walk, axis=0))) > -1e-9


@pytest.mark.parametrize("softness", SOFTNESSES)
@given(seed=st.integers(0, 2**31), turn=st.floats(-3.0, 3.0))
def test_they_know_no_axis(softness: float, seed: int, turn: float) -> None:
    course, by = a_walk(seed), rotation(turn).T
    np.testing.assert_allclose(held(course @ by, softness), held(course, softness) @ by, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("softness", SOFTNESSES)
def test_what_went_before_is_remembered_and_not_returned(softness: float) -> None:
    course = a_walk(1)
    np.testing.assert_array_equal(held(course, softness, before=100), held(course, softness)[100:])


def test_what_is_remembered_beside_leads_inwards_where_a_stop_is_full() -> None:
    course = np.linspace([0.0, 0.0], [5.0, 0.0], 200)
    off = np.array([[0.0, 0.0], [0.25, 0.0]])
    full, less = held(course, 0.0, before=199)[0], held(course, 0.0, before=199, off=off)[0]
    np.testing.assert_allclose(full - less, [0.25 * LIMITS[1], 0.0], atol=1e-12)


@pytest.mark.parametrize("softness", [0.1, 0.6, 2.0])
def test_a_table_of_the_power_law_is_as_good_as_the_law(softness: float) -> None:
    """One stop by the law itself: d held = stiffness (1 - (size / limit)^(1 / softness)) d course on the way out."""
    course, size, limit = np.linspace(0.0, 1.2, 10_000), 0.0, 0.7
    for _ in range(100_000):
        size += 1.2e-5 * (1.0 - (size / limit) ** (1.0 / softness))
    along = np.stack([course, np.zeros(10_000)], axis=1)
    one = np.array([1.0]), np.array([limit])
    found = stops(_course(along), *one, yields_of(softness), 0.0, np.zeros((1, 1, 2)))
    assert found[-1, 0] == pytest.approx(size, rel=2e-3)


def test_a_course_that_is_no_number_ends_nowhere_else() -> None:
    course = a_walk(2)
    course[300:] = np.nan
    found = held(course, 0.6, giving=0.3)
    np.testing.assert_array_equal(found[:300], held(course[:300], 0.6, giving=0.3))


def test_each_segment_begins_anew_after_its_own_way() -> None:
    one, other = a_walk(3), a_walk(4, 300)
    course = Course(
        np.concatenate([one[100:], other]),
        np.array([0, len(one) - 100, len(one) - 100 + len(other)]),
        one[:100],
        np.array([0, 100, 100]),
    )
    off = np.array([NOTHING, [[0.2, 0.0], [0.0, 0.1]]])
    found = stops(course, STIFFNESS, LIMITS, yields_of(0.6), 0.3, off)
    expected = [held(one, 0.6, 100, 0.3), held(other, 0.6, 0, 0.3, off[1])]
    np.testing.assert_array_equal(found, np.concatenate(expected))
