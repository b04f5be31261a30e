from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.frames import to_ab, to_dq

angles = st.floats(-10.0, 10.0)


@given(angles, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_there_and_back_is_where_one_was(angle: float, x: float, y: float) -> None:
    vector = np.array([[x, y]])
    np.testing.assert_allclose(to_ab(to_dq(vector, angle), angle), vector, atol=1e-10)


@given(angles, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_rotation_keeps_the_length(angle: float, x: float, y: float) -> None:
    assert np.isclose(np.linalg.norm(to_dq(np.array([[x, y]]), angle)), np.hypot(x, y))


def test_vector_along_the_rotor_is_on_the_d_axis() -> None:
    angle = 0.7
    np.testing.assert_allclose(to_dq(np.array([[np.cos(angle), np.sin(angle)]]), angle), [[1.0, 0.0]], atol=1e-15)


def test_each_sample_may_have_its_own_angle_and_float32_is_welcome() -> None:
    angles = np.array([0.0, np.pi / 2])
    x = np.ones((2, 2), dtype=np.float32)
    np.testing.assert_allclose(to_dq(x, angles), [[1.0, 1.0], [1.0, -1.0]], atol=1e-6)
