"""Of what the vectors of a recording were made, and what else it logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.logged import clarke_of_three, logged_fields, since_the_start
from protocols import Capture, SegmentStage
from tests.orchestrator.diagnosis.pieces import Array, Plan, hold, piece


def _phases(*, gain_c: float = 1.0, noise_a: float = 0.004) -> Array:
    rng = np.random.default_rng(5)
    angle = np.linspace(0.0, 6.0, 900)
    true = np.stack([np.cos(angle - k * 2.0 * np.pi / 3.0) for k in range(3)], axis=1)
    return np.asarray(true * np.array([1.0, 1.0, gain_c]) + rng.normal(0.0, noise_a, true.shape))


def _three(i_abc: Array) -> Array:
    a, b, c = i_abc.T
    return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0)], axis=1)


def _two(i_abc: Array) -> Array:
    a, b, _ = i_abc.T
    return np.stack([a, (a + 2.0 * b) / np.sqrt(3.0)], axis=1)


def test_a_vector_of_three_readings_is_reported_from_one_of_two() -> None:
    for phases in (_phases(), _phases(gain_c=1.01, noise_a=0.0)):
        assert clarke_of_three(_three(phases).astype(np.float32), phases.astype(np.float32)) is True
        assert clarke_of_three(_two(phases).astype(np.float32), phases.astype(np.float32)) is False


@pytest.mark.parametrize("computed", [0, 1, 2])
def test_a_third_current_that_was_computed_is_no_third_sensor(computed: int) -> None:
    phases = _phases()
    phases[:, computed] = -np.delete(phases, computed, axis=1).sum(axis=1)
    assert clarke_of_three(_three(phases).astype(np.float32), phases.astype(np.float32)) is False
    exact = phases.astype(np.float32).astype(np.float64)
    assert clarke_of_three(_three(exact), exact) is False


def test_a_vector_of_something_else_says_nothing_of_the_sensors() -> None:
    assert clarke_of_three(1.2 * _three(_phases()), _phases()) is None


def test_means_are_taken_of_what_is_logged_as_of_the_vectors() -> None:
    phases, warmth, n = _phases(), np.linspace(20.0, 21.0, 900), 900
    capture = Capture(
        start_s=0.0,
        sampling_frequency_hz=1e4,
        i_ab=_three(phases),
        v_ab=np.zeros((n, 2)),
        v_dc=np.full(n, 540.0),
        i_abc=phases,
        temperature_c=warmth,
    )
    found = logged_fields(capture, 90, 10)
    assert found["i_abc"] == pytest.approx(phases.reshape(90, 10, 3).mean(axis=1))
    assert found["temperature_c"] == pytest.approx(warmth.reshape(90, 10).mean(axis=1))
    assert found["clarke_of_three"] is True
    assert logged_fields(capture, n, 1)["i_abc"].base is phases


def test_temperatures_count_from_the_first_that_was_logged() -> None:
    bare = piece(Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0))).signals
    logged = [replace(bare, temperature_c=np.full(600, t)) for t in (31.0, 40.0)]
    assert [s.start_temperature_c for s in since_the_start([bare, *logged])] == [31.0, 31.0, 31.0]
    assert since_the_start([bare]) == [bare]
