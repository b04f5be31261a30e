"""Currents among others, beyond them, and on a line; which injection points are held out."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.preparation import held_out_points, lies_among

ANGLES = np.linspace(0.0, 2.0 * np.pi, 60)
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
CROSS = [np.column_stack([np.linspace(-1.0, 1.0, 50), np.zeros(50)])[:, axes] for axes in ([0, 1], [1, 0])]


@pytest.mark.parametrize(("size", "among"), [(0.5, True), (1.0, True), (1.05, True), (1.3, False)])
def test_what_is_within_a_circle_lies_among_it(size: float, among: bool) -> None:
    assert lies_among(size * CIRCLE, [CIRCLE[:30], CIRCLE[30:]]) is among


def test_a_diagonal_does_not_lie_among_the_axes_but_near_zero() -> None:
    diagonal = np.linspace(-1.0, 1.0, 50)[:, None] * np.ones(2)
    assert not lies_among(diagonal, CROSS)
    assert lies_among(0.4 * diagonal, CROSS)


def test_a_few_currents_beyond_are_let_pass() -> None:
    assert lies_among(np.concatenate([0.5 * CIRCLE] * 10 + [1.5 * CIRCLE[:30]]), [CIRCLE])


def test_on_a_line_currents_lie_between_its_ends() -> None:
    assert lies_among(0.8 * CROSS[0], CROSS[:1])
    assert not lies_among(2.0 * CROSS[0], CROSS[:1])
    assert not lies_among(CROSS[1], CROSS[:1])


def test_among_nothing_lies_nothing() -> None:
    assert not lies_among(CIRCLE, [])


@pytest.mark.parametrize("rows", [3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize("columns", [4, 5, 6, 8])
def test_of_a_grid_no_edge_no_row_and_no_column_is_held_out_as_a_whole(rows: int, columns: int) -> None:
    place = np.arange(rows * columns)
    row, column = place // columns, place % columns
    grid = np.column_stack([row - 0.5 * (rows - 1), column - 0.5 * (columns - 1)])
    held = held_out_points(grid)
    assert 0 < len(held) <= len(grid) / 5 + 1
    edge = (row % (rows - 1) == 0) | (column % (columns - 1) == 0)
    assert not edge[held].any()
    for line in (row, column):
        inner = [place[(line == x) & ~edge] for x in np.unique(line[~edge])]
        assert all(set(points) - set(held) for points in inner if len(points) > 2)


def test_of_points_measured_twice_only_the_second_is_held_out() -> None:
    points = np.array([[-3.0, -3.0], [-3.0, 3.0], [3.0, -3.0], [3.0, 3.0], [0.1, 0.0], [0.0, 0.1]])
    held = held_out_points(np.concatenate([points, 1.01 * points]))
    assert held
    assert min(held) >= len(points)
