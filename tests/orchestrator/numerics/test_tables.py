from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.tables import cubic_value_at, value_at

X, Y = np.array([-1.0, 0.5, 2.0]), np.array([-2.0, 1.0])
PLANE = 3.0 + 2.0 * X[:, None] - Y[None, :]


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.5, 1.0), (1.7, -1.9), (-1.0, -2.0)])
def test_a_plane_is_reproduced_between_the_nodes(x: float, y: float) -> None:
    assert value_at((X, Y), PLANE, x, y) == pytest.approx(3.0 + 2.0 * x - y)


def test_up_to_a_step_outside_the_edge_holds_and_nothing_is_known_beyond() -> None:
    assert value_at((X, Y), PLANE, 3.0, 1.0) == pytest.approx(PLANE[-1, -1])
    assert value_at((X, Y), PLANE, 4.0, 1.0) is None
    assert value_at((X[:1], Y), PLANE[:1], 7.0, 1.0) == pytest.approx(PLANE[0, -1])


def test_an_unknown_node_leaves_its_weight_to_the_known_ones() -> None:
    table = np.where(np.arange(6).reshape(3, 2) == 1, np.nan, PLANE)
    assert value_at((X, Y), table, 1.0, 0.0) == pytest.approx(value_at((X, Y), PLANE, 1.0, 0.0))
    at_corner = value_at((X, Y), table, -1.0, 0.0)
    assert at_corner == pytest.approx(PLANE[0, 0])
    assert value_at((X, Y), table, -1.0, 1.0) is None


def test_a_cubic_is_reproduced_between_the_nodes_and_a_hole_leaves_the_linear_value() -> None:
    x, y = np.linspace(-2.0, 3.0, 6), np.linspace(-1.0, 2.0, 5)
    table = x[:, None] ** 3 - 2.0 * x[:, None] * y[None, :] ** 2
    assert cubic_value_at((x, y), table, 0.3, 1.1) == pytest.approx(0.3**3 - 0.6 * 1.1**2)
    assert cubic_value_at((x, y), table, -2.0, 2.0) == pytest.approx(8.0)
    assert cubic_value_at((x, y), table, 3.4, 0.0) == value_at((x, y), table, 3.4, 0.0)
    table[2, 2] = np.nan
    assert cubic_value_at((x, y), table, 0.3, 1.1) == value_at((x, y), table, 0.3, 1.1)
    assert cubic_value_at((X, Y), PLANE, 0.0, 0.0) == value_at((X, Y), PLANE, 0.0, 0.0)
