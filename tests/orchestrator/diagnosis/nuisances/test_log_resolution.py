"""Logs that keep few decimals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.log_resolution import rounding_remarks
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import from_phases, from_two_phases, to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import NOISE_A, Plan, piece, sweep

NOISE = SensorNoise(NOISE_A**2 * np.eye(2), NOISE_A**2 * np.eye(2), 0.0)
ANGLE = 0.3
Rounding = Callable[[Array, float], Array]


def to(step: float) -> Callable[[Array], Array]:
    return lambda x: np.asarray(np.round(x / step) * step, dtype=np.float64)


ROUNDINGS: dict[str, Rounding] = {
    "alpha, beta": lambda x, step: to(step)(x),
    "d, q": lambda x, step: to_ab(to(step)(to_dq(x, ANGLE)), ANGLE),
    "phases": lambda x, step: from_phases(to(step)(to_phases(x))),
    "two phases": lambda x, step: from_two_phases(*to(step)(to_phases(x)[:, :2]).T),
}


def a_sweep() -> SegmentData:
    noise = np.random.default_rng(1).normal(0.0, NOISE_A, (1200, 2))
    return piece(Plan(SegmentStage.CLASSICAL, sweep(0, 2.0, 0.5, 1200)), angle=ANGLE, noise=noise)


@pytest.mark.parametrize("frame", ROUNDINGS)
def test_voltages_that_were_logged_in_large_steps_are_reported(frame: str) -> None:
    one = a_sweep()
    rounded = replace(one, command_ab=ROUNDINGS[frame](one.command_ab, 0.5))
    (stated,) = rounding_remarks([rounded], NOISE)
    assert stated.code == "rounded_voltages"
    assert stated.values["step_v"] == pytest.approx(0.5)


def test_steps_that_do_not_show_and_none_at_all_are_not_spoken_of() -> None:
    one = a_sweep()
    assert rounding_remarks([one], NOISE) == []
    assert rounding_remarks([replace(one, command_ab=to(1e-3)(one.command_ab))], NOISE) == []
    assert rounding_remarks([replace(one, current_ab=to(NOISE_A)(one.current_ab))], NOISE) == []
    assert rounding_remarks([], NOISE) == []


@pytest.mark.parametrize("frame", ROUNDINGS)
def test_currents_that_were_logged_in_steps_beyond_their_noise_are_reported(frame: str) -> None:
    one = a_sweep()
    rounded = replace(one, current_ab=ROUNDINGS[frame](one.current_ab, 5.0 * NOISE_A))
    (stated,) = rounding_remarks([rounded], NOISE)
    assert stated.code == "rounded_currents"
    assert stated.values["step_a"] == pytest.approx(5.0 * NOISE_A)
