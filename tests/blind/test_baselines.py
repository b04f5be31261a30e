"""Each of the simpler searches finds what is sparse, where the columns are not alike."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from tests.blind.baselines import METHODS, _fall


def system(seed: int) -> tuple[Array, Array]:
    """Normal matrix and gradient of 12 columns, of which 2, 5 and 9 are in the data, noise being one."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(400, 12)) * 10.0
    y = -columns[:, [2, 5, 9]] @ np.array([1.0, -0.5, 0.2]) + rng.normal(size=400)
    return columns.T @ columns, columns.T @ y


@pytest.mark.parametrize("method", METHODS)
def test_what_is_there_is_among_what_is_offered(method: str) -> None:
    normal, right = system(1)
    offered = list(METHODS[method](normal, right))
    assert {2, 5, 9} in [set(support.tolist()) for support in offered]
    best = min(offered, key=lambda s: len(s) * np.log(400.0) - _fall(normal, right, s))
    assert set(best.tolist()) == {2, 5, 9}


@pytest.mark.parametrize("method", METHODS)
def test_more_columns_explain_no_less(method: str) -> None:
    normal, right = system(2)
    all_of_it = _fall(normal, right, np.arange(12, dtype=np.int64))
    for support in METHODS[method](normal, right):
        assert 0.0 <= _fall(normal, right, support) <= all_of_it * (1.0 + 1e-9)
