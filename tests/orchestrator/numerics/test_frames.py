from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.frames import (
    from_phases,
    from_two_phases,
    inductance_to_ab,
    rotation,
    to_ab,
    to_dq,
    to_phases,
)
from orchestrator.numerics.types import Array

ANGLES = st.floats(-10.0, 10.0)
# Below the smallest normal number rounding is no share of it any more.
COMPONENTS = st.floats(-1e3, 1e3).map(lambda x: x if abs(x) > 1e-200 else 0.0)
VECTORS = st.tuples(COMPONENTS, COMPONENTS).map(lambda xy: np.array([xy]))


def same(found: Array, expected: Array) -> bool:
    """Equal but for rounding, measured against the largest number among them."""
    size = max(float(np.abs(expected).max(initial=0.0)), float(np.abs(found).max(initial=0.0)))
    return bool(np.abs(found - expected).max() <= 1e-14 * size)


@given(ANGLES, VECTORS)
def test_there_and_back_is_where_one_was(angle: float, vector: Array) -> None:
    assert same(to_ab(to_dq(vector, angle), angle), vector)


@given(ANGLES, VECTORS)
def test_rotation_is_the_matrixs_product_and_keeps_the_length(angle: float, vector: Array) -> None:
    turned = to_ab(vector, angle)
    assert same(turned, vector @ rotation(angle).T)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(vector), rel=1e-14)


@given(ANGLES, ANGLES)
def test_rotations_are_orthogonal_proper_and_add_their_angles(one: float, other: float) -> None:
    r = rotation(one)
    assert same(r @ r.T, np.eye(2))
    assert np.linalg.det(r) == pytest.approx(1.0, rel=1e-14)
    assert same(r @ rotation(other), rotation(one + other))


def test_vector_along_the_rotor_is_on_the_d_axis() -> None:
    angle = 0.7
    assert same(to_dq(np.array([[np.cos(angle), np.sin(angle)]]), angle), np.array([[1.0, 0.0]]))


def test_each_sample_may_have_its_own_angle_and_float32_is_welcome() -> None:
    angles = np.array([0.0, np.pi / 2])
    assert same(to_dq(np.ones((2, 2), dtype=np.float32), angles), np.array([[1.0, 1.0], [1.0, -1.0]]))


@given(VECTORS)
def test_phases_add_up_to_zero_and_lead_back(vector: Array) -> None:
    phases = to_phases(vector)
    assert abs(phases.sum()) <= 1e-15 * 4 * np.abs(phases).max()
    assert same(from_phases(phases), vector)
    assert same(from_two_phases(phases[:, 0], phases[:, 1]), vector)


def test_a_vectors_length_is_the_phases_peak() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    phases = to_phases(230.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    np.testing.assert_allclose(phases.max(axis=0), 230.0, rtol=1e-4)
    np.testing.assert_array_equal(turn[phases.argmax(axis=0)] // (2.0 * np.pi / 3.0), [0.0, 1.0, 2.0])


@given(VECTORS, st.floats(-1e3, 1e3))
def test_a_zero_sequence_drops_out(vector: Array, zero: float) -> None:
    shifted = from_phases(to_phases(vector) + zero)
    assert np.abs(shifted - vector).max() <= 1e-14 * max(abs(zero), np.abs(vector).max())


def test_two_constants_are_one_vector() -> None:
    np.testing.assert_allclose(from_two_phases(1.0, -0.5), [1.0, 0.0])


@given(ANGLES, VECTORS, st.tuples(st.floats(0.1, 9.0), st.floats(-1.0, 1.0), st.floats(0.1, 9.0)))
def test_an_inductance_makes_of_a_turned_current_the_turned_flux(
    angle: float, current: Array, henries: tuple[float, float, float]
) -> None:
    dd, dq, qq = henries
    flux = current @ np.array([[dd, dq], [dq, qq]])
    ((aa, ab, bb),) = inductance_to_ab(np.array([henries]), angle)
    turned = to_ab(current, angle) @ np.array([[aa, ab], [ab, bb]])
    np.testing.assert_allclose(turned, to_ab(flux, angle), atol=1e-13 * np.abs(current).max() * sum(map(abs, henries)))
