"""Demodulation against motors whose Hessian is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.analysis import PhaseLoss, Ripple, demodulate, fixed_axis_rad, injection_frequency
from protocols import Capture, NotMeasuredError
from tests.orchestrator.analysis.plant import (
    L_D,
    L_Q,
    R_S,
    SAMPLING_HZ,
    Array,
    Run,
    capture_of,
    flux_for,
    injection_voltage,
    integrate_motor,
    linear_current,
    saturated_current,
    saturated_hessian,
)
from tests.support.cases import few
from tests.support.close import assert_close

POINTS = np.array([[0.0, 0.0], [1.5, 1.5], [-2.0, -3.0]])
TIME_CONSTANT_S = L_Q / R_S


@cache
def injected(
    frequency: float = 500.0,
    rotation: float = 4.0,
    waveform: str = "square",
    resistance: float = R_S,
    saturated: bool = True,
) -> Run:
    current_of = saturated_current if saturated else linear_current
    voltage = injection_voltage(resistance * POINTS, 40.0, frequency, rotation, waveform)
    return integrate_motor(voltage, flux_for(POINTS, current_of), 5000, current_of, resistance=resistance)


def true_hessian(ripple: Ripple) -> Array:
    return saturated_hessian(flux_for(ripple.current_dq, saturated_current))


def off_percent(ripple: Ripple) -> float:
    truth = true_hessian(ripple)
    return 100.0 * float(np.abs(ripple.hessian - truth).max() / truth.max())


@pytest.mark.parametrize("point", range(3))
def test_finds_the_hessian_of_a_saturated_motor_to_a_thousandth(point: int) -> None:
    ripple = demodulate(capture_of(injected(), point), 0.0, time_constant_s=TIME_CONSTANT_S)
    assert off_percent(ripple) < 0.1


def test_constant_inductances_come_out_to_a_few_millionths() -> None:
    ripple = demodulate(capture_of(injected(saturated=False), 1), 0.0, time_constant_s=TIME_CONSTANT_S)
    assert_close(ripple.hessian, np.diag([1 / L_D, 1 / L_Q]), 2e-5)
    assert np.abs(ripple.third).max() < 0.1


def test_third_derivatives_are_the_hessians_slope() -> None:
    ripple = demodulate(capture_of(injected(), 1), 0.0, time_constant_s=TIME_CONSTANT_S)
    x, y = flux_for(ripple.current_dq, saturated_current)
    truth = [54 + 960 * x, 160 * y, 12 + 160 * x, 1200 * y]
    np.testing.assert_allclose(ripple.third, truth, atol=3.0)


def test_current_is_that_at_the_mean_flux() -> None:
    run = injected()
    ripple = demodulate(capture_of(run, 1), 0.0, discard_s=0.3)
    at_mean_flux = saturated_current(run.psi_dq[3000:, 1].mean(axis=0))
    assert np.abs(ripple.current_dq - at_mean_flux).max() < 3e-4
    assert np.abs(ripple.mean_current_dq - at_mean_flux).max() > 3e-3


@few("waveform", ["square", "sine"])
@few("frequency", [500.0, 300.0, 437.0], fast=2)
def test_any_waveform_and_frequency_will_do(waveform: str, frequency: float) -> None:
    capture = capture_of(injected(frequency, waveform=waveform), 1)
    ripple = demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S)
    assert ripple.frequency_hz == pytest.approx(frequency, rel=1e-3)
    assert off_percent(ripple) < 0.3


@few("rotation", [0.0, 1.0, -7.0], fast=2)
def test_frequency_is_found_whatever_the_rotation(rotation: float) -> None:
    v = injected(rotation=rotation).v_dq[:, 0]
    assert injection_frequency(v, SAMPLING_HZ) == pytest.approx(500.0, rel=1e-3)


def test_turning_rotor_and_belief_together_changes_nothing() -> None:
    straight = demodulate(capture_of(injected(), 2), 0.0, time_constant_s=TIME_CONSTANT_S)
    turned = demodulate(capture_of(injected(), 2, angle=1.1), 1.1, time_constant_s=TIME_CONSTANT_S)
    assert_close(turned.hessian, straight.hessian, 1e-9)
    assert_close(turned.current_dq, straight.current_dq, 1e-9)


def test_a_wrong_belief_turns_the_hessian() -> None:
    ripple = demodulate(capture_of(injected(saturated=False), 0, angle=0.1), 0.0, time_constant_s=TIME_CONSTANT_S)
    expected = 0.5 * (1 / L_D - 1 / L_Q) * np.sin(0.2)
    assert ripple.hessian[0, 1] == pytest.approx(expected, rel=1e-3)


@few("resistance", [1.0, 4.3, 20.0, 100.0], fast=2)
def test_resistance_does_not_enter(resistance: float) -> None:
    ripple = demodulate(capture_of(injected(resistance=resistance, saturated=False), 0), 0.0, discard_s=0.1)
    assert_close(ripple.hessian, np.diag([1 / L_D, 1 / L_Q]), 4e-4)


@few("resistance", [30.0, 90.0])
def test_a_ripple_that_decays_within_its_period_is_as_good(resistance: float) -> None:
    run = injected(resistance=resistance)
    assert resistance / L_D > 0.3 * 500.0
    assert off_percent(demodulate(capture_of(run, 1), 0.0, discard_s=0.1)) < 0.1


@pytest.mark.parametrize("delay", [1, 3])
def test_a_known_delay_is_taken_out(delay: int) -> None:
    capture = capture_of(injected(), 1, delay=delay)
    known = demodulate(capture, 0.0, voltage_delay_samples=delay, time_constant_s=TIME_CONSTANT_S)
    ignored = demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S)
    assert off_percent(known) < 0.1
    assert off_percent(ignored) > 2.0


def test_half_a_sample_of_delay_is_the_mean_of_two_commands() -> None:
    capture = capture_of(injected(), 1)
    halves = 0.5 * (capture.v_ab[1:] + capture.v_ab[:-1])
    smeared = Capture(
        start_s=0.0, sampling_frequency_hz=SAMPLING_HZ, i_ab=capture.i_ab[1:], v_ab=halves, v_dc=capture.v_dc[1:]
    )
    expected = demodulate(smeared, 0.0, discard_s=0.0999)
    found = demodulate(capture, 0.0, voltage_delay_samples=0.5, discard_s=0.1)
    np.testing.assert_allclose(found.hessian, expected.hessian, rtol=1e-9)


def test_the_ripple_itself_tells_how_long_the_start_lasts() -> None:
    ripple = demodulate(capture_of(injected(saturated=False), 0), 0.0)
    assert 1.0 / ripple.decay_per_s == pytest.approx(TIME_CONSTANT_S, rel=0.01)


def test_single_precision_is_widened_not_computed_in() -> None:
    capture = capture_of(injected(), 1)
    single = capture.model_copy(update={n: getattr(capture, n).astype(np.float32) for n in ("i_ab", "v_ab")})
    double = single.model_copy(update={n: getattr(single, n).astype(np.float64) for n in ("i_ab", "v_ab")})
    expected = demodulate(double, 0.3, time_constant_s=TIME_CONSTANT_S, voltage_delay_samples=0.5)
    found = demodulate(single, 0.3, time_constant_s=TIME_CONSTANT_S, voltage_delay_samples=0.5)
    np.testing.assert_allclose(found.hessian, expected.hessian, rtol=1e-9)
    np.testing.assert_allclose(found.current_dq, expected.current_dq, rtol=1e-9)


def test_whole_periods_only_are_used() -> None:
    ripple = demodulate(capture_of(injected(), 0), 0.0, discard_s=0.01234)
    assert ripple.samples % 20 == 0


def test_standard_deviations_are_those_of_repetitions() -> None:
    run = injected()
    repeated = [
        demodulate(capture_of(run, 1, noise_a=5e-3, seed=10 * n), 0.0, time_constant_s=TIME_CONSTANT_S)
        for n in range(60)
    ]
    seen = np.std([[r.hessian[0, 0], r.hessian[0, 1], r.hessian[1, 1], *r.third] for r in repeated], axis=0)
    reported = np.sqrt(np.diag(repeated[0].covariance))
    np.testing.assert_allclose(seen, reported, rtol=0.35)


PHASES = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])
NEAR_ZERO = np.array([[0.25, 0.0], [1.5, 0.9], [-2.0, -1.155]])
"""Currents at which the ripple takes a phase current through zero."""


@cache
def behind_dead_time() -> Run:
    """8 V of dead time; while the injection turns, the mean current moves by tenths of an ampere."""

    def acts(v: Array, i: Array) -> Array:
        return np.asarray(v - 8.0 * np.tanh(i @ PHASES.T / 0.09) @ (2 / 3 * PHASES))

    base = R_S * NEAR_ZERO + (8.0 * np.tanh(NEAR_ZERO @ PHASES.T / 0.09)) @ (2 / 3 * PHASES)
    voltage = injection_voltage(base, 40.0, 500.0, 4.0)
    return integrate_motor(voltage, flux_for(NEAR_ZERO, saturated_current), 5000, saturated_current, acts=acts)


@pytest.mark.parametrize("point", range(3))
def test_dead_time_that_is_known_is_taken_out_of_the_ripple(point: int) -> None:
    knots = np.concatenate([np.linspace(0.01, 0.3, 30), [0.4, 0.6]])
    loss = PhaseLoss(knots, 8.0 * np.tanh(knots / 0.09))
    capture = capture_of(behind_dead_time(), point)
    unaware = off_percent(demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S))
    known = off_percent(demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S, loss=loss))
    assert known < 0.35
    assert known < 0.3 * unaware


def test_where_no_phase_current_passes_zero_a_known_dead_time_changes_nothing() -> None:
    loss = PhaseLoss(np.array([0.01, 0.1]), np.array([4.0, 8.0]))
    capture = capture_of(injected(), 2)
    bare = demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S)
    aware = demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S, loss=loss)
    np.testing.assert_allclose(aware.hessian, bare.hessian, rtol=1e-9)


def test_a_wave_that_does_not_turn_is_refused() -> None:
    with pytest.raises(NotMeasuredError, match="one axis only"):
        demodulate(capture_of(injected(rotation=0.0), 0), 0.0, time_constant_s=TIME_CONSTANT_S, where="x-1")


def test_no_injection_or_too_little_of_it_is_refused() -> None:
    held = Capture(
        start_s=0.0,
        sampling_frequency_hz=SAMPLING_HZ,
        i_ab=np.zeros((500, 2)),
        v_ab=np.full((500, 2), 3.0),
        v_dc=np.full(500, 540.0),
    )
    with pytest.raises(NotMeasuredError, match="no injected voltage"):
        demodulate(held, 0.0)
    short = capture_of(injected(), 0)
    short = short.model_copy(update={"i_ab": short.i_ab[:70], "v_ab": short.v_ab[:70], "v_dc": short.v_dc[:70]})
    with pytest.raises(NotMeasuredError, match="injection-7"):
        demodulate(short, 0.0, discard_s=0.0, where="injection-7")


@cache
def along(axis: int) -> Run:
    """A square wave along one axis of the rotor, while the other is held."""
    to_d = injection_voltage(R_S * POINTS, 40.0, 500.0, 0.0)
    voltage = to_d if axis == 0 else lambda k, i: R_S * POINTS + (to_d(k, i) - R_S * POINTS)[:, ::-1]
    return integrate_motor(voltage, flux_for(POINTS, saturated_current), 5000, saturated_current)


@pytest.mark.parametrize("point", range(3))
def test_waves_along_either_axis_tell_together_what_one_that_turns_does(point: int) -> None:
    d, q = (capture_of(along(axis), point, noise_a=2e-3) for axis in (0, 1))
    ripple = demodulate(d, 0.0, time_constant_s=TIME_CONSTANT_S, more_captures=(q,))
    assert off_percent(ripple) < 0.5
    assert (
        ripple.samples > 1.5 * demodulate(capture_of(injected(), point), 0.0, time_constant_s=TIME_CONSTANT_S).samples
    )


def test_a_wave_that_current_control_answers_on_the_other_axis_does_not_turn() -> None:
    capture = capture_of(along(0), 0)
    answered = np.array(capture.v_ab)
    answered[:, 1] += 0.2 * np.roll(answered[:, 0] - answered[:, 0].mean(), 2)
    for v_ab, axis in ((answered, 0), (capture_of(along(1), 0).v_ab, 1)):
        angle = fixed_axis_rad(v_ab)
        assert angle is not None
        assert abs((np.sin, np.cos)[axis](angle)) < 0.2


@few("turns", [0.15, 0.25, 1.0])
def test_a_wave_that_turns_a_little_is_none_along_one_axis(turns: float) -> None:
    capture = capture_of(injected(rotation=turns * SAMPLING_HZ / 5000), 0)
    assert fixed_axis_rad(capture.v_ab) is None
    assert off_percent(demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S)) < 0.2


@cache
def rotating(frequency: float = 480.0) -> Run:
    """A voltage vector that rotates at the injected frequency itself, on what holds the points."""

    def voltage(k: int, _: Array) -> Array:
        turn = 2.0 * np.pi * frequency * k / SAMPLING_HZ
        return R_S * POINTS + 40.0 * np.array([np.cos(turn), np.sin(turn)])

    return integrate_motor(voltage, flux_for(POINTS, saturated_current), 5000, saturated_current)


def test_the_frequency_of_a_rotating_vector_is_that_of_its_turns() -> None:
    for sense in (1.0, -1.0):
        v_ab = capture_of(rotating(), 0).v_ab * np.array([1.0, sense])
        assert injection_frequency(v_ab, SAMPLING_HZ) == pytest.approx(480.0, rel=1e-3)


@pytest.mark.parametrize("point", range(3))
def test_a_rotating_vector_tells_inductances_beside_a_resistance_that_is_known(point: int) -> None:
    capture = capture_of(rotating(), point, noise_a=2e-3)
    ripple = demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S, resistance_ohm=R_S)
    assert off_percent(ripple) < 0.5
    assert ripple.decay_per_s == pytest.approx(R_S * np.linalg.eigvalsh(ripple.hessian)[0], rel=1e-2)
    with pytest.raises(NotMeasuredError, match="none is known"):
        demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S)


def test_a_resistance_that_is_known_changes_nothing_where_the_wave_tells_it() -> None:
    capture = capture_of(injected(), 1)
    reported, known = (
        demodulate(capture, 0.0, time_constant_s=TIME_CONSTANT_S, resistance_ohm=r) for r in (None, 5 * R_S)
    )
    np.testing.assert_array_equal(reported.hessian, known.hessian)


@pytest.mark.parametrize("noise_a", [0.0, 0.003])
def test_noise_does_not_bias_an_inductance_far_below_its_resistance(noise_a: float) -> None:
    ohm, henry, rate = 5.85, np.array([360e-6, 400e-6]), 20e3
    n = 10_000
    t = np.arange(n) / rate
    axis = np.stack([np.cos(2 * np.pi * 4.0 * t), np.sin(2 * np.pi * 4.0 * t)], axis=1)
    square = np.where((np.arange(n) // 10) % 2 == 0, 1.0, -1.0)
    v = 0.55 * square[:, None] * axis
    kept = np.exp(-ohm / henry / rate)
    i = np.zeros((n, 2))
    for k in range(n - 1):
        i[k + 1] = kept * i[k] + (1.0 - kept) * v[k] / ohm
    i += np.random.default_rng(1).normal(scale=noise_a, size=i.shape)
    capture = Capture(start_s=0.0, sampling_frequency_hz=rate, i_ab=i, v_ab=v, v_dc=np.full(n, 42.0))
    ripple = demodulate(capture, 0.0)
    inductance = np.diag(np.linalg.inv(ripple.hessian))
    std = np.sqrt(np.diag(ripple.covariance))[[0, 2]] * inductance**2
    np.testing.assert_allclose(inductance, henry, atol=max(4.0 * float(std.max()), 1e-6))
    np.testing.assert_allclose(inductance, henry, rtol=0.02)
