from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.frames import from_phases, to_dq, to_phases
from orchestrator.numerics.kernels import delayed_means, dq_of, for_kernels, phases_of, unit_vectors, vector_of
from orchestrator.numerics.types import Array

VECTORS = np.random.default_rng(1).normal(size=(20, 2)) * 30.0


@pytest.mark.parametrize("vector", VECTORS)
def test_one_sample_is_what_the_array_has(vector: Array) -> None:
    alpha, beta = vector
    rounding = 4e-15 * float(np.abs(vector).max())
    phases = np.array(phases_of(alpha, beta))
    np.testing.assert_allclose(phases, to_phases(vector[None])[0], rtol=0.0, atol=rounding)
    np.testing.assert_allclose(np.array(vector_of(*phases)), from_phases(phases[None])[0], rtol=0.0, atol=rounding)
    turned = np.array(dq_of(alpha, beta, np.cos(0.7), np.sin(0.7)))
    np.testing.assert_allclose(turned, to_dq(vector[None], 0.7)[0], rtol=0.0, atol=rounding)


def test_one_precision_for_all_and_no_copy_of_what_fits() -> None:
    single, double = VECTORS.astype(np.float32), VECTORS
    assert for_kernels(single, single)[0] is single
    assert for_kernels(double)[0] is double
    assert [x.dtype for x in for_kernels(single, double)] == [np.float64, np.float64]
    assert all(x.flags.c_contiguous for x in for_kernels(double[:, ::-1], double.T))


@given(
    st.floats(-1e3, 1e3),
    st.lists(st.one_of(st.floats(-0.2, 0.2), st.floats(-10.0, 10.0)), min_size=1, max_size=20),
)
def test_unit_vectors_are_cosine_and_sine_near_the_first_angle_and_far_from_it(
    first: float, steps: list[float]
) -> None:
    angle = first + np.array([0.0, *steps])
    # An angle of a thousand radians is itself known to one part in 2^53 of it.
    exact = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(unit_vectors(angle), exact, atol=4.0 * np.finfo(float).eps * max(1.0, abs(first)))


@given(st.integers(1, 7), st.integers(1, 30), st.floats(0.0, 4.0))
def test_means_of_late_rows_are_what_happens_between_the_means_of_an_integral(
    width: int, blocks: int, late: float
) -> None:
    """The integral's mean over a block's readings and that over the next one's differ by this times the width."""
    x = np.random.default_rng(blocks).normal(size=(width * blocks + width - 1, 2))
    whole, part = int(late), late % 1.0
    rows = np.arange(len(x))
    moved = (1.0 - part) * x[np.maximum(rows - whole, 0)] + part * x[np.maximum(rows - whole - 1, 0)]
    integral = np.cumsum(moved, axis=0) - moved
    of_blocks = integral[: width * blocks].reshape(blocks, width, 2).mean(axis=1)
    found = delayed_means(x, width, whole, part)
    np.testing.assert_allclose(found[:-1], np.diff(of_blocks, axis=0) / width, atol=1e-12 * len(x))
    np.testing.assert_allclose(found[-1], moved[: width * blocks][-width:].mean(axis=0), atol=1e-12 * len(x))
