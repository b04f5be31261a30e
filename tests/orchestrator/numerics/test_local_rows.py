"""The triangular factor of a matrix with local rows."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.numerics.local_rows import triangular_factor


@given(seed=st.integers(0, 999), block=st.integers(1, 5), blocks=st.integers(1, 6), reach=st.integers(1, 3))
def test_the_factor_has_the_normal_matrix_of_the_rows(seed: int, block: int, blocks: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    rows = np.zeros((int(rng.integers(1, 80)), block * blocks))
    for row in rows:
        first = block * int(rng.integers(blocks))
        row[first : first + block * reach] = rng.normal(size=len(row[first : first + block * reach]))
    factor = triangular_factor(rows, block)
    assert np.array_equal(factor, np.triu(factor))
    np.testing.assert_allclose(factor.T @ factor, rows.T @ rows, atol=1e-10)
