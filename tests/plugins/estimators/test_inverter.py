from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from plugins.estimators._inverter import fit_voltage, step_ab
from tests.orchestrator.analysis.plant import Array
from tests.support.cases import few
from tests.support.close import assert_close

PHASES = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])


def on_both_axes(sizes: Array) -> Array:
    """Currents of these sizes and both signs on each axis, shape (n, 2)."""
    held: Array = np.concatenate([np.outer(sign * sizes, e) for e in np.eye(2) for sign in (1.0, -1.0)])
    return held


HELD = on_both_axes(np.array([0.1, 0.3, 1.0, 2.0, 3.0]))
TIME_S = np.arange(len(HELD), dtype=float)
PWM_HZ = np.where(np.arange(len(HELD)) % 2, 20e3, 10e3)


def test_a_step_is_odd_and_a_volt_a_phase_is_four_thirds_on_the_phases_axis() -> None:
    assert_close(step_ab(HELD, 0.05), -step_ab(-HELD, 0.05), 1e-15)
    assert_close(step_ab(np.array([[5.0, 0.0]]), 0.05), [[4 / 3, 0.0]], 1e-15)


def test_resistance_step_bias_and_drift_are_separated() -> None:
    error = np.where(PWM_HZ > 15e3, 1.6, 0.8)[:, None] * step_ab(HELD, 0.06)
    drift = 1e-3 * (TIME_S - TIME_S.mean())[:, None]
    v = (4.0 + drift) * HELD + error + np.array([0.1, -0.2])
    fit = fit_voltage(HELD, v, TIME_S, PWM_HZ)
    assert fit.resistance_ohm == pytest.approx(4.0, abs=2e-3)
    assert fit.drift_ohm_per_s == pytest.approx(1e-3, rel=0.1)
    assert fit.error_v[10e3] == pytest.approx(0.8, rel=0.01)
    assert fit.error_v[20e3] == pytest.approx(1.6, rel=0.01)
    np.testing.assert_allclose(fit.bias_v, [0.1, -0.2], atol=2e-3)


def clipped(i_ab: Array) -> Array:
    """A step that is complete at 60 mA."""
    x = np.clip(i_ab @ PHASES.T / 0.06, -1.0, 1.0)
    taken: Array = (x * (1.5 - 0.5 * x**2)) @ (2 / 3 * PHASES)
    return taken


def rounded(i_ab: Array) -> Array:
    """A step that never is complete."""
    x = i_ab @ PHASES.T / 0.03
    taken: Array = (x / np.sqrt(1.0 + x**2)) @ (2 / 3 * PHASES)
    return taken


@few("step", [clipped, rounded])
def test_a_step_of_another_shape_does_not_bend_the_resistance(step: Callable[[Array], Array]) -> None:
    held = np.concatenate([HELD, HELD * 0.5, HELD * 0.15])
    inside = []
    for seed in range(20):
        noise = 1e-3 * np.random.default_rng(seed).normal(size=held.shape)
        fit = fit_voltage(held, 4.0 * held + 0.8 * step(held) + noise, np.zeros(len(held)), np.full(len(held), 10e3))
        inside.append(abs(fit.resistance_ohm - 4.0) < 2.1 * fit.std_ohm)
    assert np.mean(inside) > 0.8


@pytest.mark.slow
def test_the_interval_is_that_of_repetitions() -> None:
    fits = []
    voltage = 4.0 * HELD + 0.8 * step_ab(HELD, 0.2)
    for seed in range(30):
        noise = 0.01 * np.random.default_rng(seed).normal(size=HELD.shape)
        fits.append(fit_voltage(HELD, voltage + noise, TIME_S, PWM_HZ))
    assert np.std([f.resistance_ohm for f in fits]) == pytest.approx(np.median([f.std_ohm for f in fits]), rel=0.4)


@pytest.mark.slow
def test_an_inverter_that_keeps_nothing_makes_no_resistance_uncertain() -> None:
    """Its step may have any shape where it has no size: along a hexagon one of them is nearly a resistance."""
    turn = np.repeat(np.arange(6) * np.pi / 3.0, 3)
    held = 17.0 * np.tile([0.3, 0.7, 1.0], 6)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    time_s, pwm_hz = 0.25 * np.arange(18.0), np.full(18, 1e4)
    apart = []
    for seed in range(20):
        noise = 4e-3 * np.random.default_rng(seed).normal(size=held.shape)
        fit = fit_voltage(held, 1.2 * held + noise, time_s, pwm_hz)
        assert fit.std_ohm < 0.01
        apart.append(abs(fit.resistance_ohm - 1.2) / fit.std_ohm)
    assert np.mean(np.array(apart) < 2.05) > 0.8


def test_one_held_current_gives_the_ratio() -> None:
    fit = fit_voltage(np.array([[2.0, 0.0]]), np.array([[8.4, 0.0]]), np.zeros(1), np.full(1, 1e4))
    assert fit.resistance_ohm == pytest.approx(4.2)
    assert fit.error_v == {}


def bridge_without_short_pulses(i_ab: Array, shortest_v: float, ohm: float) -> Array:
    """Voltage that a current control commands where pulses below some voltage never reach the phase."""
    needed = ohm * (i_ab @ PHASES.T)
    commanded: Array = (np.sign(needed) * np.maximum(np.abs(needed), shortest_v)) @ (2 / 3 * PHASES)
    return commanded


@pytest.mark.parametrize("shortest_v", [1.0, 2.0, 4.0, 6.0])
def test_a_minimum_pulse_is_no_dead_time_and_leaves_the_resistance_uncertain(shortest_v: float) -> None:
    held = on_both_axes(np.array([1.0, 3.0, 5.0, 7.5, 10.0]))
    commanded: Array = bridge_without_short_pulses(held, shortest_v, 0.63)
    commanded += 5e-3 * np.random.default_rng(1).normal(size=held.shape)
    time_s = np.arange(len(held), dtype=float)
    fit = fit_voltage(held, commanded, time_s, np.full(len(held), 1e4), own_std_v=5e-3)
    assert fit.error_v == {}
    assert fit.unlike_step_v > 0.01
    assert fit.with_step_ohm < 0.63 < fit.resistance_ohm + 2.0 * fit.std_ohm


@pytest.mark.parametrize("gain_b", [0.9, 1.1])
def test_unequal_sensors_say_nothing_against_a_dead_time(gain_b: float) -> None:
    read: Array = HELD @ PHASES.T * [1.0, gain_b, 1.0] @ (2 / 3 * PHASES)
    voltage = 4.0 * HELD + 0.8 * step_ab(HELD, 0.06) + 1e-3 * np.random.default_rng(1).normal(size=HELD.shape)
    fit = fit_voltage(read, voltage, TIME_S, np.full(len(HELD), 1e4))
    assert fit.unlike_step_v == 0.0
    assert fit.error_v[1e4] == pytest.approx(0.8, rel=0.2)
