"""One pass over vectors is what numpy makes of them, whatever the precision and the order in memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from plugins.effects._vectors import less_constant, minus_interval_means, plus_along_d, times_matrix
from protocols import RealArray

RNG = np.random.default_rng(5)
X, Y, SIZES, THETA = RNG.normal(size=(9, 2)), RNG.normal(size=(9, 2)), RNG.normal(size=9), RNG.normal(size=9)
ALONG = np.stack([np.cos(THETA), np.sin(THETA)], axis=1)
MATRIX = RNG.normal(size=(2, 2))
STARTS = np.array([0, 4, 5, 9], dtype=np.int64)
SEGMENT = np.repeat([0, 1, 2], np.diff(STARTS))
CONSTANTS, MATRICES = RNG.normal(size=(3, 2)), RNG.normal(size=(3, 2, 2))
NEXT = Y[[1, 2, 3, 3, 4, 6, 7, 8, 8]]


@pytest.mark.parametrize(
    ("work", "expected"),
    [
        (lambda x: less_constant(x, STARTS, CONSTANTS), X - CONSTANTS[SEGMENT]),
        (lambda x: plus_along_d(x, STARTS, SIZES, THETA), X + SIZES[:, None] * ALONG),
        (lambda x: times_matrix(x, STARTS, MATRICES), np.einsum("ki,kij->kj", X, MATRICES[SEGMENT])),
        (lambda x: minus_interval_means(x, STARTS, Y, MATRIX), X - 0.5 * (Y + NEXT) @ MATRIX),
    ],
    ids=["less_constant", "plus_along_d", "times_matrix", "minus_interval_means"],
)
def test_it_is_what_numpy_makes_of_it(work: Callable[[RealArray], Array], expected: Array) -> None:
    given = X.copy()
    np.testing.assert_allclose(work(given), expected, rtol=1e-12)
    np.testing.assert_allclose(work(np.asfortranarray(given)), expected, rtol=1e-12)
    np.testing.assert_allclose(work(given.astype(np.float32)), expected, rtol=1e-5, atol=1e-6)
    assert (given == X).all()
