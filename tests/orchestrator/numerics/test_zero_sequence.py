"""Gains of three sensors by the sum of their readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.numerics.zero_sequence import gains_of
from protocols import SegmentStage, Signals
from tests.orchestrator.diagnosis.pieces import Plan, hold, piece, sweep


def _signals(gains: tuple[float, float, float], *, noise_a: float = 0.004, offset_a: float = 0.0) -> list[Signals]:
    rng = np.random.default_rng(4)
    found = []
    for plan in (hold(2.0, 0.0), hold(0.0, 2.0), sweep(0, 2.5, 0.0), sweep(1, 2.5, 0.0)):
        made = piece(Plan(SegmentStage.CLASSICAL, plan)).signals
        alpha, beta = made.i_ab.T
        true = np.stack([alpha, -0.5 * alpha + np.sqrt(0.75) * beta, -0.5 * alpha - np.sqrt(0.75) * beta], axis=1)
        read = true * np.array(gains) + rng.normal(0.0, noise_a, true.shape) + offset_a
        a, b, c = read.T
        vector = np.stack([(2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0)], axis=1)
        found.append(replace(made, i_ab=vector, i_abc=read, clarke_of_three=True))
    return found


@pytest.mark.parametrize("gains", [(1.0, 1.0, 1.01), (1.01, 1.0, 1.0), (0.998, 1.001, 1.004)])
def test_gains_are_found_but_for_what_they_have_in_common(gains: tuple[float, float, float]) -> None:
    found = gains_of(_signals(gains, offset_a=0.02))
    assert found is not None
    assert np.abs(found.off_mean - (np.array(gains) - np.mean(gains))).max() < 2e-4
    assert found.std.max() < 1e-4


def test_a_difference_is_one_where_it_is_beyond_its_noise() -> None:
    found = gains_of(_signals((1.0, 1.0, 1.01)))
    assert found is not None
    assert found.differ((-0.5, -0.5, 1.0)) == pytest.approx(0.01, rel=0.03)
    assert found.differ((1.0, -1.0, 0.0)) is None
    alike = gains_of(_signals((1.005, 1.005, 1.005)))
    assert alike is not None
    assert alike.differ((-0.5, -0.5, 1.0)) is None


def test_two_sensors_say_nothing_by_their_sum() -> None:
    assert gains_of([replace(s, clarke_of_three=False) for s in _signals((1.0, 1.0, 1.01))]) is None
    assert gains_of([piece(Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0))).signals]) is None
