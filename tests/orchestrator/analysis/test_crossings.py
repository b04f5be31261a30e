from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import FluxPath, crossings_of, join_paths
from orchestrator.numerics.types import Array

INDUCTANCE = np.diag([0.04, 0.07])
ALONG = np.linspace(-3.0, 3.0, 31)


def path(axis: int, held: float, constant: tuple[float, float] = (0.0, 0.0)) -> FluxPath:
    current: Array = np.full((len(ALONG), 2), held)
    current[:, axis] = ALONG
    return FluxPath(current, current @ INDUCTANCE + constant, np.zeros(2))


def test_differences_are_reported_where_paths_cross_with_their_constants_left_as_they_are() -> None:
    found = crossings_of([path(0, 1.0), path(1, -2.0, (0.001, -0.002)), path(0, 2.0)])
    assert found.pairs == ((0, 1), (1, 2))
    assert found.difference == pytest.approx(np.array([[-0.001, 0.002], [0.001, -0.002]]), abs=1e-12)
    assert found.psi[0] == pytest.approx([-0.08 + 0.0005, 0.07 - 0.001])


def test_paths_that_cross_nothing_have_no_differences() -> None:
    found = crossings_of([path(0, 1.0), path(0, 2.0)])
    assert found.pairs == ()
    assert found.difference.shape == found.psi.shape == (0, 2)


def test_joined_paths_agree_where_only_their_constants_did_not() -> None:
    paths = [path(0, -1.0, (0.1, 0.0)), path(0, 1.0), path(1, -1.0, (0.0, 0.3)), path(1, 1.0, (-0.2, 0.0))]
    network = join_paths(paths)
    assert network.misfit is not None
    assert np.abs(network.misfit).max() < 1e-12
