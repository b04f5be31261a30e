"""What is left is called by its shape."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.judgement.residual_pattern import map_asymmetry, residual_pattern
from tests.orchestrator.diagnosis.pieces import (
    Array,
    fitter,
    free_model,
    plan,
    prepared,
    with_voltage,
)

MADE = prepared(plan(sparse=True))
CURRENT_A = 2.5


def _shapes(voltage: dict[str, Array] | Array) -> dict[str, float]:
    maker = fitter(with_voltage(MADE, voltage))
    return dict(residual_pattern(maker, maker.fit(free_model()), CURRENT_A))


def test_noise_has_no_shape_that_explains_it() -> None:
    assert set(_shapes(np.zeros(2))) <= {"other"}


def test_a_constant_voltage_is_constant() -> None:
    shapes = _shapes(np.array([0.3, 0.0]))
    assert max(shapes, key=lambda name: shapes[name]) == "constant"
    assert shapes["constant"] > 0.9
    assert sum(shapes.values()) == pytest.approx(1.0)


def test_a_resistance_that_depends_on_the_direction_is_anisotropic() -> None:
    stretched = {p.segment.id: p.signals.i_ab * np.array([0.2, -0.2]) for p in MADE.pieces}
    shapes = _shapes(stretched)
    assert max(shapes, key=lambda name: shapes[name]) == "anisotropic_resistance"


def test_a_voltage_that_grows_with_the_square_of_the_current_is_even_in_it() -> None:
    a, b = np.array([1.0, 0.0]), np.array([-0.5, np.sqrt(0.75)])
    phases = np.stack([a, b, -a - b])
    squares = {p.segment.id: (p.signals.i_ab @ phases.T) ** 2 @ phases * (0.1 * 2.0 / 3.0) for p in MADE.pieces}
    shapes = _shapes(squares)
    assert max(shapes, key=lambda name: shapes[name]) == "even_phase_current"


def test_a_map_that_is_even_and_reciprocal_breaks_neither() -> None:
    maker = fitter(MADE)
    parity, reciprocity = map_asymmetry(maker, maker.fit(free_model()), CURRENT_A)
    rated_wb = 0.07 * CURRENT_A
    assert max(parity) < 0.01 * rated_wb
    assert reciprocity < 0.01
