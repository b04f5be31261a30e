"""What differences of readings say of the noise, whatever the current does meanwhile."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.diagnosis.weak_form.sensor_scatter import (
    repeats,
    scatter_beside_answer,
    scatter_between,
    scatter_of,
)
from orchestrator.numerics.types import Array

COVARIANCE = 1e-5 * np.array([[1.0, -0.3], [-0.3, 0.5]])


def _noise(n: int) -> Array:
    drawn = np.random.default_rng(1).normal(size=(n, 2)) @ np.linalg.cholesky(COVARIANCE).T
    return np.asarray(drawn, dtype=np.float64).reshape(n, 2)


@pytest.mark.parametrize("ramp", [0.0, 50.0])
def test_covariance_of_a_ramp_is_the_noises_alone(ramp: float) -> None:
    n = 20_000
    i_ab = _noise(n) + ramp * np.linspace(0.0, 1.0, n)[:, None]
    scatter = scatter_of(i_ab, None)
    np.testing.assert_allclose(scatter.covariance, COVARIANCE, rtol=0.1)
    assert scatter.correlation == pytest.approx(0.0, abs=0.07)


@pytest.mark.parametrize("rho", [-0.4, 0.0, 0.3, 0.7, 0.9])
def test_how_alike_successive_readings_are_is_seen_under_a_ramp_and_better_at_rest(rho: float) -> None:
    n = 20_000
    noise = lfilter([math.sqrt(1.0 - rho**2)], [1.0, -rho], _noise(n + 200), axis=0)[200:]
    ramp = noise + 50.0 * np.linspace(0.0, 1.0, n)[:, None]
    assert scatter_of(ramp, None).correlation == pytest.approx(rho, abs=0.12)
    assert scatter_of(noise, None, steady=True).correlation == pytest.approx(rho, abs=0.025)
    late = noise + np.exp(-np.arange(n) / 50.0)[:, None]
    assert scatter_of(late, None, steady=True).correlation == pytest.approx(rho, abs=0.025)


def test_readings_that_never_change_do_not_tell_how_alike_they_are() -> None:
    assert math.isnan(scatter_of(np.zeros((100, 2)), None, steady=True).correlation)


def test_a_ripple_that_repeats_cancels_between_its_periods() -> None:
    n, period = 8000, 20
    k = np.arange(n)
    wave = np.where(k % period < period // 2, 0.5, -0.5)
    turn = 2.0 * np.pi * k / n
    i_ab = _noise(n) + wave[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    np.testing.assert_allclose(scatter_of(i_ab, float(period)).covariance, COVARIANCE, rtol=0.15)


@pytest.mark.parametrize(("n", "period"), [(8000, 20.4), (100, 20.0)])
def test_periods_that_do_not_repeat_whole_or_often_enough_say_nothing(n: int, period: float) -> None:
    scatter = scatter_of(_noise(n), period)
    assert np.isnan(scatter.covariance).all()
    assert math.isnan(scatter.correlation)
    assert scatter.spectrum.size == 0


def test_between_the_edges_of_voltage_steps_the_noise_is_separated_from_the_current() -> None:
    n, swing = 20_000, 40
    sign = np.where(np.arange(n) // swing % 2 == 0, 1.0, -1.0)
    current = np.column_stack([np.cumsum(sign) / swing, np.zeros(n)])
    v_ab = np.column_stack([100.0 * sign, np.zeros(n)])
    np.testing.assert_allclose(scatter_between(_noise(n) + current, v_ab).covariance, COVARIANCE, rtol=0.1)


def test_a_staircase_scatters_as_its_readings_do() -> None:
    n = 20_000
    steps = np.repeat(np.random.default_rng(2).normal(size=(40, 2)), n // 40, axis=0)
    answer = lfilter([0.2], [1.0, -0.8], steps, axis=0)
    scatter = scatter_of(_noise(n) + answer, None)
    np.testing.assert_allclose(scatter.covariance, COVARIANCE, rtol=0.1, atol=1e-7)
    assert scatter.correlation == pytest.approx(0.0, abs=0.07)


def test_a_ripple_that_turns_into_another_scatters_as_its_readings_do() -> None:
    n, period = 20_000, 20
    wave = np.where(np.arange(n) % period < period // 2, 1.0, -1.0)
    ripple = np.stack([np.where(np.arange(n) < n // 2, wave, 0.0), np.where(np.arange(n) < n // 2, 0.0, wave)], axis=1)
    np.testing.assert_allclose(scatter_of(_noise(n) + ripple, period).covariance, COVARIANCE, rtol=0.15, atol=1e-7)


def test_a_current_that_decays_all_along_makes_no_readings_alike() -> None:
    n = 6000
    decaying = _noise(n) + np.exp(-np.arange(n) / 1500.0)[:, None] * np.array([8.0, -3.0])
    scatter = scatter_of(decaying, None, steady=True)
    assert scatter.correlation == pytest.approx(0.0, abs=0.1)
    np.testing.assert_allclose(scatter.covariance, COVARIANCE, rtol=0.15, atol=1e-7)


def _answer(
    v_ab: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Current of two inductances, a resistance and an eddy current that dies away in three samples, without noise."""
    step = np.array([0.02, 0.01])
    driven = lfilter([1.0], [1.0, -math.exp(-1.0 / 3.0)], v_ab, axis=0)
    answer = lfilter([0.0, 1.0], [1.0, -0.995], (v_ab + 0.1 * driven) * step, axis=0)
    return np.asarray(answer, dtype=np.float64).reshape(v_ab.shape)


def test_the_answer_to_random_steps_of_voltage_is_no_noise() -> None:
    n, rng = 10_000, np.random.default_rng(3)
    held = rng.integers(2, 9, n)
    v_ab = np.repeat(rng.choice([-20.0, 20.0], (n, 2)), held, axis=0)[:n]
    answer = _answer(v_ab)
    scatter = scatter_beside_answer(answer + _noise(n), v_ab)
    assert np.ptp(answer) > 1000.0 * math.sqrt(COVARIANCE[0, 0])
    np.testing.assert_allclose(scatter.covariance, COVARIANCE, rtol=0.15, atol=1e-7)


def test_a_current_that_a_chirp_drives_does_not_explain_its_own_noise() -> None:
    n = 10_000
    t = np.arange(n) / n
    phase = 2.0 * np.pi * (50.0 * t + 400.0 * t**2)
    v_ab = 20.0 * np.stack([np.sin(phase), np.cos(phase)], axis=1)
    scatter = scatter_beside_answer(_answer(v_ab) + _noise(n), v_ab)
    np.testing.assert_allclose(scatter.covariance, COVARIANCE, rtol=0.2, atol=1e-7)


def test_a_segment_of_few_readings_tells_no_scatter() -> None:
    assert np.isnan(scatter_beside_answer(_noise(100), np.zeros((100, 2))).covariance).all()


@pytest.mark.parametrize("turns", [0.0, 2.0, 50.0])
def test_a_wave_whose_direction_turns_slowly_repeats_and_a_random_one_does_not(turns: float) -> None:
    n, period = 6000, 20
    square = 40.0 * np.where(np.arange(n) // (period // 2) % 2, 1.0, -1.0)
    angle = 2.0 * np.pi * turns * np.arange(n) / n
    wave = np.stack([square * np.cos(angle), square * np.sin(angle)], axis=1)
    assert repeats(wave, period) == (turns < 50.0)
    assert not repeats(np.random.default_rng(4).choice([-40.0, 40.0], (n, 2)), period)
    assert not repeats(wave[:30], period)
