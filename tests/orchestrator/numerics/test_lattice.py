"""Steps of a log."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.lattice import step_of


@given(step=st.floats(1e-3, 10.0), seed=st.integers(0, 2**31), reach=st.integers(200, 20_000))
def test_the_step_of_rounded_numbers_is_found(step: float, seed: int, reach: int) -> None:
    whole = np.random.default_rng(seed).integers(-reach, reach, 5000)
    logged = (step * whole).astype(np.float32).astype(np.float64)
    assert step_of(logged) == pytest.approx(step, rel=1e-5)


@given(seed=st.integers(0, 2**31), scale=st.floats(1e-3, 1e3))
def test_numbers_that_are_not_rounded_have_none(seed: int, scale: float) -> None:
    numbers = np.random.default_rng(seed).normal(0.0, scale, 5000).astype(np.float32).astype(np.float64)
    assert step_of(numbers) is None


def test_a_few_levels_have_none() -> None:
    assert step_of(np.tile([-80.0, 0.0, 80.0], 1000)) is None
    assert step_of(np.zeros(10)) is None
    assert step_of(np.zeros(0)) is None
