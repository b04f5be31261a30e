"""The paper's sums over inductances that are known."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import crossings_of
from orchestrator.numerics.types import Array
from orchestrator.stages import paths
from plugins.commands.reproduction.literal._paths import Rule, lines_of, parity_percent, summed

HELD = (-3.0, -1.5, 0.0, 1.5, 3.0)
TARGETS = np.array(paths(("q", "d", "dq"), HELD, np.round(np.arange(-3.0, 3.01, 0.1), 3).tolist()))


def flux(i: Array) -> Array:
    """A motor that saturates, even in i_q."""
    d, q = i.T
    return np.stack([0.04 * np.tanh(d / 4.0) - 0.001 * q**2, 0.08 * np.tanh(q / 4.0) - 0.002 * d * q], axis=1)


def inductance(i: Array) -> Array:
    d, q = i.T
    dd, qq = 0.01 / np.cosh(d / 4.0) ** 2, 0.02 / np.cosh(q / 4.0) ** 2 - 0.002 * d
    return np.stack([np.stack([dd, -0.002 * q], axis=1), np.stack([-0.002 * q, qq], axis=1)], axis=1)


def off(rule: Rule) -> Array:
    """Flux along all paths less the true one."""
    found = summed(lines_of(TARGETS), TARGETS, inductance(TARGETS), rule)
    return np.concatenate([path.psi - flux(path.current) for path in found])


def test_paths_are_reported_from_what_was_requested() -> None:
    lines = lines_of(TARGETS)
    assert [line.axis for line in lines] == ["q"] * 5 + ["d"] * 5 + ["dq"]
    assert [line.held_a for line in lines] == [*HELD, *HELD, 0.0]
    assert all(len(line.points) == 61 for line in lines)


def test_constant_inductances_are_summed_without_an_error() -> None:
    matrix = np.array([[0.04, 0.003], [0.003, 0.07]])
    found = summed(lines_of(TARGETS), TARGETS, np.broadcast_to(matrix, (len(TARGETS), 2, 2)), Rule.RECTANGLE)
    assert len(found) == 11
    assert all(np.abs(path.psi - path.current @ matrix).max() < 1e-12 for path in found)
    assert np.abs(crossings_of(found).difference).max() < 1e-12


def test_rectangles_leave_what_a_step_of_saturation_is_and_trapezoids_its_square() -> None:
    by_rectangles, by_trapezoids = (float(np.abs(off(rule)).max()) for rule in Rule)
    assert 2e-4 < by_rectangles < 2e-3
    assert by_trapezoids < 0.05 * by_rectangles


def test_rectangles_fall_short_of_a_saturating_axis() -> None:
    found = summed(lines_of(TARGETS), TARGETS, inductance(TARGETS), Rule.RECTANGLE)
    path = next(p for p in found if np.ptp(p.current[:, 1]) == 0.0 and p.current[0, 1] == 0.0)
    assert (np.abs(path.psi[:, 0]) <= np.abs(flux(path.current)[:, 0])).all()


def test_an_even_motor_has_no_departure_from_parity() -> None:
    assert parity_percent(lines_of(TARGETS), TARGETS, inductance(TARGETS)).max() < 1e-9


def test_an_odd_part_of_l_dd_is_its_departure_from_parity() -> None:
    matrix = inductance(TARGETS)
    mean = float(np.abs(np.einsum("nii->ni", matrix)).mean())
    matrix[:, 0, 0] += 0.01 * mean * TARGETS[:, 1] / 3.0
    d, q, cross = parity_percent(lines_of(TARGETS), TARGETS, matrix)
    assert d == pytest.approx(1.0, rel=1e-3)
    assert max(q, cross) < 1e-9
