from __future__ import annotations

import numpy as np

from plugins.estimators._lines import straight_lines


def jittered(points: list[tuple[float, float]], size: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array(points) + np.random.default_rng(2).normal(size=(len(points), 2)) * size


def test_a_grid_is_its_rows_and_columns() -> None:
    sides = (-3.0, -1.5, 0.0, 1.5, 3.0)
    lines = straight_lines(jittered([(d, q) for d in sides for q in sides], 0.02))
    assert sorted(len(line) for line in lines) == [5] * 10


def test_paths_that_cross_are_found_whole() -> None:
    fine = np.arange(-30, 31) * 0.1
    points = [(h, float(s)) for h in (-2.0, 0.0, 2.0) for s in fine] + [
        (float(s), h) for h in (-2.0, 0.0, 2.0) for s in fine
    ]
    current = jittered(points, 0.004)
    lines = straight_lines(current)
    assert len(lines) == 6
    assert all(len(line) == 61 for line in lines)
    for line in lines:
        along = np.ptp(current[line], axis=0)
        assert along.min() < 0.05 < 5.9 < along.max()


def test_points_at_random_are_hardly_lines() -> None:
    scattered = np.random.default_rng(4).uniform(-1, 1, (200, 2))
    assert max((len(line) for line in straight_lines(scattered)), default=0) < 12
