from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import steep_steps
from protocols import NotMeasuredError

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
SIDES = np.linspace(-4.0, 4.0, 5)
GRID = np.stack(np.meshgrid(SIDES, SIDES, indexing="ij"), axis=-1).reshape(-1, 2)
KNEE_A = 0.8


def inductance(current: Array) -> Array:
    """L_qq falls to a fourth within a knee about i_q = 0; L_dd is the same everywhere."""
    matrix = np.tile(np.eye(2), (len(current), 1, 1))
    matrix[:, 1, 1] += 3.0 / (1.0 + (current[:, 1] / KNEE_A) ** 2)
    return matrix


def steps(current: Array, narrowest_wb: float = 0.0) -> list[tuple[float, tuple[float, float]]]:
    found = steep_steps(current, inductance(current), steepest=1.6, narrowest_wb=narrowest_wb, where="test")
    return [(ratio, (d, q)) for ratio, (d, q) in found]


def test_the_middles_of_steep_steps_are_given_the_steepest_first() -> None:
    found = steps(GRID)
    assert {middle for _, middle in found} == {(d, q) for d in SIDES for q in (-1.0, 1.0)}
    ratios = [ratio for ratio, _ in found]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[0] == pytest.approx(4.0 / (1.0 + 3.0 / (1.0 + (2.0 / KNEE_A) ** 2)))


def test_halving_comes_to_an_end_and_grades_the_lines_towards_the_knee() -> None:
    current = GRID
    for _ in range(8):
        found = steps(current)
        if not found:
            break
        current = np.concatenate([current, np.array([middle for _, middle in found])])
    assert not found
    q = np.unique(current[current[:, 0] == 0.0, 1])
    assert np.diff(q).min() < KNEE_A
    assert q[-1] - q[-2] == SIDES[1] - SIDES[0]


def test_a_step_that_the_ripple_reaches_across_is_left() -> None:
    # 2 A of 1.4 to 4 H: 5.4 Wb.
    assert steps(GRID, narrowest_wb=5.0)
    assert not steps(GRID, narrowest_wb=6.0)


def test_the_rim_of_a_clipped_grid_is_looked_at_across_its_corners() -> None:
    inside = GRID[np.abs(GRID).sum(axis=1) <= 4.0]
    assert {(d, q) for _, (d, q) in steps(inside)} >= {(3.0, 1.0), (3.0, -1.0), (-3.0, 1.0), (-3.0, -1.0)}


def test_points_in_line_span_nothing() -> None:
    with pytest.raises(NotMeasuredError, match="test: points"):
        steps(GRID[:5])
