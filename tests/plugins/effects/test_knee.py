"""The knee of a step: whatever a bench's looks like, a few parts meet it; parts of none are the simple form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import erf

from orchestrator.numerics.types import Array
from plugins.effects.inverter import PART_WIDTHS, DeadTime, _soft_sign
from tests.plugins.effects.readings import corrected, readings, reads

STEP, END = 0.01, 40.0
TABLE = np.asarray(np.arange(0.0, END + 1.5 * STEP, STEP), dtype=np.float64)
X = np.asarray(np.arange(1, 601) * 0.01, dtype=np.float64)
NONE = (0.0,) * len(PART_WIDTHS)

STEPS: dict[str, Callable[[Any], Any]] = {
    "hyperbolic tangent": np.tanh,
    "circular tangent": lambda x: 2.0 / np.pi * np.arctan(x),
    "Gaussian": erf,
    "exponential": lambda x: 1.0 - np.exp(-x),
    "Langevin": lambda x: 1.0 / np.tanh(x) - 1.0 / x,
    "ramp": lambda x: np.minimum(x, 1.0),
    "rounded ramp": lambda x: np.where(x < 1.0, 1.5 * x - 0.5 * x**3, 1.0),
    "ramp and tangent": lambda x: 0.5 * np.tanh(x) + 0.5 * np.minimum(x, 1.0),
}


def _read(threshold: float, softness: float, parts: tuple[float, ...]) -> Array:
    table = _soft_sign(TABLE, softness, parts)
    return np.asarray(np.interp(X / threshold, np.arange(len(table)) * STEP, table), dtype=np.float64)


@pytest.mark.parametrize("name", STEPS)
def test_steps_of_other_forms_are_met_by_softness_and_then_parts(name: str) -> None:
    true = np.asarray(STEPS[name](X), dtype=np.float64)

    def rough_off(p: Array) -> Array:
        return _read(float(np.exp(p[0])), float(p[1]), NONE) - true

    def off(p: Array) -> Array:
        return _read(float(np.exp(p[0])), float(p[1]), tuple(p[2:])) - true

    rough = least_squares(rough_off, [0.0, 0.5], bounds=([-5, 0.02], [5, 1.0]))
    found = least_squares(off, [*rough.x, *NONE], bounds=([-5, 0.02, -1, -1, -1], [5, 1.0, 1, 1, 1]))
    assert np.sqrt(np.mean(found.fun**2)) < 2e-3
    # The simple knee is as good for the ramp alone.
    assert name == "ramp" or np.sqrt(np.mean(rough.fun**2)) > 2.0 * np.sqrt(np.mean(found.fun**2))


def test_a_step_is_whole_far_beyond_its_knee_whatever_its_parts() -> None:
    table = _soft_sign(TABLE, 0.5, (0.3, -0.2, 0.4))
    assert table[0] == 0.0
    assert table[-1] == pytest.approx(1.0, abs=1e-3)


def test_parts_are_requested_once_the_softness_brings_nothing_more() -> None:
    declared = {p.name: p.detail for p in DeadTime.Parameters.declared()}
    assert not declared["softness"]
    assert declared["narrow"]
    assert declared["wide"]
    assert declared["wider"]
    assert declared["switched"]


@pytest.mark.parametrize("knees", [0.0, 0.5, 1.0, 2.0, 30.0, 300.0])
def test_constant_capacitances_take_what_it_takes_to_charge_them(knees: float) -> None:
    """A leg swings by i / i_th of the bus within a dead time: the triangle under the swing is what is given back."""
    i = 0.05 * knees * np.array([1.0, 0.0])
    signals = reads(readings(), np.tile(i, (400, 1)))
    whole, charged = (
        corrected(DeadTime(), signals, voltage_v=8.0, threshold_a=0.05, softness=0.02, charged=part).v_ab
        for part in (0.0, 1.0)
    )
    a, others = (0.5 * x if x < 1.0 else 1.0 - 0.5 / x for x in (knees, 0.5 * knees))
    lost = (signals.v_ab - charged)[5, 0] / 8.0
    assert lost == pytest.approx((2.0 * a + 2.0 * others) / 3.0, rel=1e-4, abs=1e-9)
    assert lost <= (signals.v_ab - whole)[5, 0] / 8.0 + 1e-9
