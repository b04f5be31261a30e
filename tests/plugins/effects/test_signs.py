"""Inverter, sensors, resistance and timing: each correction undoes the catalogue's equation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from plugins.effects.inverter import BusSag, DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents
from plugins.effects.resistance import (
    PhaseResistanceImbalance,
    ResistanceWithTemperature,
    SkinEffect,
    WindingHeating,
)
from plugins.effects.sensors import (
    CurrentGainMismatch,
    CurrentNonlinearity,
    CurrentOffset,
    CurrentOffsetDrift,
    ThirdCurrentSensor,
)
from plugins.effects.timing import CurrentFilter, VoltageDelay
from protocols import Effect, LossHistory, RealArray, Signals
from tests.plugins.effects.readings import FS, corrected, readings, reads
from tests.support.close import assert_close


def _two(i_ab: RealArray) -> Array:
    """Phases a and b."""
    return np.stack([i_ab[:, 0], -0.5 * i_ab[:, 0] + math.sqrt(0.75) * i_ab[:, 1]], axis=1)


def _from_two(i_two: Array) -> Array:
    return np.stack([i_two[:, 0], (i_two[:, 0] + 2.0 * i_two[:, 1]) / math.sqrt(3.0)], axis=1)


def test_dead_time_opposes_the_current_and_grows_with_the_pwm_frequency() -> None:
    for pwm_hz, volts in ((FS, 8.0), (2 * FS, 16.0)):
        signals = readings(pwm_hz=pwm_hz)
        lost = signals.v_ab - corrected(DeadTime(), signals, voltage_v=8.0, threshold_a=0.01).v_ab
        # At the start i_a > 0 > i_b = i_c: the vector is 4/3 V along a.
        assert lost[0, 0] == pytest.approx(4.0 / 3.0 * volts, rel=0.01)


@pytest.mark.parametrize(
    ("effect", "values", "sign"),
    [
        (DeadTime(), {"voltage_v": 8.0}, 1.0),
        (DeviceDrop(), {"voltage_v": 1.0}, 1.0),
        (VoltageBias(), {"bias_a_v": 0.3, "bias_b_v": -0.15}, 1.0),
        (BusSag(), {"per_watt": 1e-4}, 1.0),
        (WindingHeating(), {"rise_per_watt": 1e-3}, 1.0),
        (SkinEffect(), {"extra_ohm": 1.0}, 1.0),
        (CurrentOffset(), {"offset_a_a": 0.1, "offset_b_a": -0.05}, -1.0),
    ],
    ids=lambda one: getattr(one, "name", ""),
)
def test_what_an_effect_leaves_has_the_sign_that_its_signature_states(
    effect: Effect, values: dict[str, float], sign: float
) -> None:
    signals = readings()
    true = corrected(effect, signals, **values)
    # Residual v - R i of what was read, where v - R i of what was corrected is zero but for the flux.
    left = (signals.v_ab - true.v_ab) - signals.resistance_ohm[:, None] * (signals.i_ab - true.i_ab)
    left = left + (true.resistance_ohm - signals.resistance_ohm)[:, None] * true.i_ab
    along = left[:, 0] * (np.ones(400) if "constant" in effect.signature else signals.i_ab[:, 0])
    assert sign * np.mean(along) > 0.0
    assert ("minus" in effect.signature) == (sign < 0.0)


@pytest.mark.parametrize(
    ("effect", "values", "words", "sign"),
    [
        (VoltageDelay(), {"delay_s": 2e-5}, "against the slope", -1.0),
        (CurrentFilter(), {"time_constant_s": 2e-5}, "against the slope", -1.0),
        (EddyCurrents(), {"core_loss_ohm": 500.0}, "sign of its slope", 1.0),
    ],
    ids=lambda one: getattr(one, "name", ""),
)
def test_measured_less_modelled_ripple_goes_with_the_slope_or_against_it_as_the_signature_states(
    effect: Effect, values: dict[str, float], words: str, sign: float
) -> None:
    assert words in effect.signature
    n, inductance_h = 400, 0.043
    v = np.where(np.arange(n) % 20 < 10, 40.0, -40.0)[:, None] * np.array([1.0, 0.0])
    i = np.cumsum(v, axis=0) / (inductance_h * FS)
    signals = replace(readings(n), v_ab=v, i_ab=i - i.mean(axis=0), resistance_ohm=np.zeros(n))
    correction = effect.correct(signals, effect.Parameters(**values))
    true = signals.corrected(correction)
    # A voltage that is not there moves the current by its integral; a current that is only read, by itself.
    of_voltage = np.cumsum(true.v_ab - signals.v_ab, axis=0) / (inductance_h * FS)
    magnetising = true.i_ab if correction.i_m_ab is None else correction.i_m_ab
    apart = (of_voltage + signals.i_ab - magnetising)[20:-20, 0]
    assert sign * np.mean((apart - apart.mean()) * v[20:-20, 0]) > 0.0


PICTURES = (
    "Residual on the current plane",
    "Residual against each phase's current",
    "Flux loop",
    "Evenness in i_q",
    "Ripple",
    "R_s against the heat",
    "In no picture by itself",
)


@pytest.mark.parametrize("name", [info.name for info in installed(PluginKind.EFFECTS)])
def test_a_signature_begins_with_the_picture_to_look_at(name: str) -> None:
    assert load_plugin(PluginKind.EFFECTS, name).signature.startswith(PICTURES)


def test_a_slow_sweep_has_the_skin_effects_inductance_and_the_ripple_has_not() -> None:
    """R_x / (2 pi f_c) below the corner f_c, R_x f_c / (2 pi f^2) above it."""
    extra_ohm, corner_hz, n = 2.0, 60.0, 20_000
    inductances = []
    for hertz in (2.0, 500.0):
        turn = np.exp(2j * np.pi * hertz * np.arange(n) / FS)
        signals = replace(readings(n), i_ab=np.stack([turn.real, turn.imag], axis=1))
        true = corrected(SkinEffect(), signals, extra_ohm=extra_ohm, corner_hz=corner_hz)
        dropped = (signals.v_ab - true.v_ab) @ np.array([1.0, 1.0j])
        middle = 0.5 * (turn[n // 2 : -1] + turn[n // 2 + 1 :])
        inductances.append(np.mean(dropped[n // 2 : -1] / middle).imag / (2.0 * np.pi * hertz))
    np.testing.assert_allclose(inductances[0], extra_ohm / (2.0 * np.pi * corner_hz), rtol=0.02)
    assert inductances[1] < 0.02 * inductances[0]
    assert SkinEffect.signature.startswith("Ripple: larger than the model's")


def test_voltage_bias_is_subtracted() -> None:
    signals = readings()
    out = corrected(VoltageBias(), signals, bias_a_v=0.3, bias_b_v=-0.15)
    assert_close(signals.v_ab - out.v_ab, np.tile([0.3, 0.0], (400, 1)), 1e-15, of=signals.v_ab)


def test_bus_sag_lowers_the_voltage_by_the_power() -> None:
    signals = readings()
    out = corrected(BusSag(), signals, per_watt=1e-3)
    power = 1.5 * np.sum(signals.v_ab[0] * 0.5 * (signals.i_ab[0] + signals.i_ab[1]))
    np.testing.assert_allclose(out.v_ab[0], signals.v_ab[0] * (1 - 1e-3 * power))


@pytest.mark.parametrize("at_once", [0.0, 0.2])
def test_a_bus_that_lags_has_sagged_by_what_its_capacitor_gave_on_the_mean_over_an_interval(at_once: float) -> None:
    volts, tau, n = 10.0, 5e-4, 4000
    v_ab, i_ab = np.tile([volts, 0.0], (n, 1)), np.zeros((n, 2))
    # The load comes between the first two rows: the first interval has half of it.
    i_ab[1:, 0] = 2.0
    signals = replace(readings(n), v_ab=v_ab, i_ab=i_ab)
    values = {"per_watt": 1e-3, "lag_s": tau, "at_once": at_once}
    sag = 1.0 - corrected(BusSag(), signals, **values).v_ab[:, 0] / volts
    power, since = 1.5 * volts * 2.0, np.arange(n - 2) / FS
    first = 0.5 * power
    mean = power + (first - power) * np.exp(-since / tau) * tau * FS * -np.expm1(-1.0 / (tau * FS))
    np.testing.assert_allclose(sag[1:-1], 1e-3 * (at_once * power + (1.0 - at_once) * mean), rtol=1e-9)


def test_what_a_motor_returns_lifts_a_bus_that_takes_nothing_back_by_the_energy_in_its_capacitor() -> None:
    volts, tau, n, per_watt = 10.0, 5e-4, 400, 1e-5
    v_ab, i_ab = np.tile([volts, 0.0], (n, 1)), np.zeros((n, 2))
    i_ab[1:, 0] = -2.0
    signals = replace(readings(n), v_ab=v_ab, i_ab=i_ab)
    lifted, steady = (
        corrected(BusSag(), signals, per_watt=per_watt, lag_s=tau, one_way=way).v_ab[:, 0] / volts - 1.0
        for way in (1.0, 0.0)
    )
    returned = 1.5 * volts * 2.0
    # dv / v = k dE / (R C): the energy of each interval is there at its end, half of it on its mean.
    np.testing.assert_allclose(np.diff(lifted[1:]), per_watt * returned / (tau * FS), rtol=1e-6)
    assert steady[-1] == pytest.approx(per_watt * returned, rel=1e-6)


def test_delay_mixes_in_the_voltage_of_the_interval_before() -> None:
    signals = readings()
    out = corrected(VoltageDelay(), signals, delay_s=25e-6)
    np.testing.assert_allclose(out.v_ab[10], 0.75 * signals.v_ab[10] + 0.25 * signals.v_ab[9])


def test_sensor_errors_are_undone() -> None:
    signals = readings()
    true = _two(signals.i_ab)
    gained = reads(signals, _from_two(true * np.array([1.01, 0.99])))
    assert_close(corrected(CurrentGainMismatch(), gained, gain_a_minus_b=0.02).i_ab, signals.i_ab, 1e-14)
    offset = reads(signals, _from_two(true + np.array([0.02, -0.01])))
    read = corrected(CurrentOffset(), offset, offset_a_a=0.02, offset_b_a=-0.01)
    assert_close(read.i_m_ab, signals.i_ab, 1e-14)
    bent = reads(signals, _from_two(true + 3e-4 * true**3))
    assert_close(corrected(CurrentNonlinearity(), bent, cubic_per_a2=3e-4).i_ab, signals.i_ab, 1e-7)
    bent = reads(signals, _from_two(true + 4e-4 * true**2 + 3e-4 * true**3))
    both = corrected(CurrentNonlinearity(), bent, cubic_per_a2=3e-4, square_per_a=4e-4)
    assert_close(both.i_ab, signals.i_ab, 1e-6)


def _of_three(signals: Signals, i_abc: Array) -> Signals:
    """As a drive of three sensors reads it: the vector is the Clarke transform of all."""
    a, b, c = i_abc.T
    read = reads(signals, np.stack([(2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)], axis=1))
    return replace(read, i_abc=i_abc, clarke_of_three=True)


def test_errors_of_three_sensors_are_undone() -> None:
    signals = readings()
    a, b = _two(signals.i_ab).T
    true = np.stack([a, b, -a - b], axis=1)
    gained = _of_three(signals, true * np.array([1.0, 1.0, 1.01]))
    assert_close(corrected(ThirdCurrentSensor(), gained, gain_c_minus_1=0.01).i_ab, signals.i_ab, 1e-14)
    gained = _of_three(signals, true * np.array([1.01, 0.99, 1.0]))
    assert_close(corrected(CurrentGainMismatch(), gained, gain_a_minus_b=0.02).i_m_ab, signals.i_ab, 1e-14)
    offset = _of_three(signals, true + np.array([0.03, 0.0, 0.01]))
    assert_close(corrected(CurrentOffset(), offset, offset_a_a=0.02, offset_b_a=-0.01).i_ab, signals.i_ab, 1e-14)
    bent = _of_three(signals, true + 3e-4 * true**3)
    assert_close(corrected(CurrentNonlinearity(), bent, cubic_per_a2=3e-4).i_ab, signals.i_ab, 1e-5)


def test_a_third_sensor_that_is_known_not_to_be_there_has_no_error() -> None:
    signals = replace(readings(), clarke_of_three=False)
    assert not ThirdCurrentSensor().shows_in(signals)
    assert corrected(ThirdCurrentSensor(), signals, gain_c_minus_1=0.01) is signals


def test_resistance_goes_with_the_thermometer_from_its_first_reading() -> None:
    warm = replace(readings(), temperature_c=np.full(400, 35.0), start_temperature_c=25.0)
    out = corrected(ResistanceWithTemperature(), warm, per_k=0.004)
    np.testing.assert_allclose(out.resistance_ohm, 4.0 * 1.04)
    assert ResistanceWithTemperature().shows_in(warm)
    assert not ResistanceWithTemperature().shows_in(readings())


def test_a_drift_grows_with_the_time_since_the_start_and_settles() -> None:
    signals = readings()
    now = 5.0 + np.arange(400) / FS
    rates = np.array([2e-4, -1e-4])
    drifted = reads(signals, signals.i_ab + _from_two(now[:, None] * rates))
    read = corrected(CurrentOffsetDrift(), drifted, rate_a_a_per_s=2e-4, rate_b_a_per_s=-1e-4)
    assert_close(read.i_ab, signals.i_ab, 1e-13)
    assert_close(read.i_m_ab, signals.i_ab, 1e-13)
    settled = corrected(CurrentOffsetDrift(), signals, rate_a_a_per_s=2e-4, settling_per_s=1.0)
    grown = _two(signals.i_ab - settled.i_ab)[:, 0]
    assert_close(grown, 2e-4 * (1.0 - np.exp(-now)), 1e-9)


def test_sensor_lag_is_undone_on_a_triangle() -> None:
    signals = readings()
    true = np.stack([0.5 * np.abs(np.arange(400) % 20 - 10.0), np.zeros(400)], axis=1)
    tau = 8e-6
    slope = np.diff(true, axis=0, prepend=true[:1] - (true[1:2] - true[:1])) * FS
    out = corrected(CurrentFilter(), reads(signals, true - tau * slope), time_constant_s=tau)
    assert np.abs(out.i_ab - true)[1:].max() < 0.1 * tau * np.abs(slope).max() * 2


@pytest.mark.parametrize("samples", [0.2, 1.0, 3.0])
def test_sensor_lag_of_any_length_is_undone_where_the_true_course_is_known(samples: float) -> None:
    """The sensor's own equation in small steps, the current being straight between samples."""
    signals, fine = readings(), 500
    true = np.stack([0.5 * np.abs(np.arange(400) % 20 - 10.0), np.zeros(400)], axis=1)
    read = true.copy()
    read[0, 0] = reading = float(true[0, 0] - samples * (true[1, 0] - true[0, 0]))
    for k in range(1, 400):
        for x in true[k - 1, 0] + (true[k, 0] - true[k - 1, 0]) * (np.arange(fine) + 0.5) / fine:
            reading += (x - reading) / (samples * fine)
        read[k, 0] = reading
    known = replace(reads(signals, read), i_smooth_ab=true)
    out = corrected(CurrentFilter(), known, time_constant_s=samples / FS)
    # By half an explicit step, in which the current moves by so much.
    assert np.abs(out.i_ab - true).max() < np.abs(np.diff(true, axis=0)).max() / fine


def test_a_smooth_current_that_ran_away_does_not_take_the_reading_along() -> None:
    signals = readings()
    away = replace(signals, i_smooth_ab=1e4 * np.random.default_rng(3).normal(size=(400, 2)))
    change = corrected(CurrentFilter(), away, time_constant_s=8e-6).i_ab - signals.i_ab
    assert np.abs(change).max() <= 8e-6 * FS * 3.0 * np.ptp(signals.i_ab, axis=0).max()


def test_extra_resistance_drops_in_its_own_phase() -> None:
    signals = readings()
    out = corrected(PhaseResistanceImbalance(), signals, extra_a_ohm=0.3, extra_b_ohm=0.0)
    mean = 0.5 * (signals.i_ab[0] + signals.i_ab[1])
    assert_close(signals.v_ab[0] - out.v_ab[0], [0.3 * mean[0] * 2.0 / 3.0, 0.0], 1e-15, of=signals.v_ab)


def test_heating_reaches_its_steady_rise() -> None:
    losses = LossHistory(time_s=np.linspace(0.0, 5000.0, 2001), power_w=np.full(2001, 20.0), captured=np.ones(2001))
    signals = replace(readings(), losses=losses, start_s=4900.0)
    out = corrected(WindingHeating(), signals, rise_per_watt=0.003, time_constant_s=150.0)
    # 20 W warm it by 6 %, and the warmer winding loses more: y = 0.06 (1 + y).
    assert out.resistance_ohm[0] / 4.0 == pytest.approx(1.0 + 0.06 / (1.0 - 0.06), abs=2e-5)


def test_skin_effect_drops_what_its_two_corners_let_through() -> None:
    n, hertz = 20_000, 50.0
    turn = np.exp(2j * np.pi * hertz * np.arange(n) / FS)
    i_ab = np.stack([turn.real, turn.imag], axis=1)
    signals = replace(readings(n), i_ab=i_ab)
    v_ab = corrected(SkinEffect(), signals, extra_ohm=2.0, corner_hz=60.0, variance=0.25, low_share=0.7).v_ab
    dropped = (signals.v_ab - v_ab) @ np.array([1.0, 1.0j])
    fast = 1.0 - 0.7 / (1.0 + 1j * hertz / (60.0 * math.exp(-0.5))) - 0.3 / (1.0 + 1j * hertz / (60.0 * math.exp(0.5)))
    middle = 0.5 * (turn[10_000:-1] + turn[10_001:])
    assert_close(dropped[10_000:-1], 2.0 * fast * middle, 0.01, of=2.0 * middle)


def test_a_devices_drop_changes_with_what_its_leg_has_carried() -> None:
    time_s = np.linspace(0.0, 20.0, 401)
    late = LossHistory(time_s=time_s, power_w=np.where(time_s < 4.0, 0.0, 9.0))
    signals = replace(readings(), losses=late)
    values = {"voltage_v": 0.8, "threshold_a": 0.03, "warming_s": 2.0}
    cold, warm = (signals.v_ab - corrected(DeviceDrop(), signals, **values, warming=part).v_ab for part in (0.0, -0.1))
    # A second after the current came, of what sixteen make of it.
    part = math.expm1(-1.0 / 2.0) / math.expm1(-16.0 / 2.0)
    assert_close(warm[0], (1.0 - 0.1 * part) * cold[0], 1e-2 * part, of=cold[0])
    unknown = readings()
    assert_close(corrected(DeviceDrop(), unknown, **values, warming=-0.1).v_ab, unknown.v_ab - cold, 1e-12, of=cold)


def test_a_joint_that_warms_grows_with_the_loss_so_far() -> None:
    """After a loss of 10 W for three time constants a joint of 0.1 /W has (1 - e^-3) of its rise."""
    signals = readings()
    losses = LossHistory(time_s=np.linspace(0.0, 6.0, 601), power_w=np.full(601, 10.0))
    warm = replace(signals, losses=losses, start_s=3.0)
    cold, hot = (
        (s.v_ab - corrected(PhaseResistanceImbalance(), s, extra_a_ohm=0.5, rise_per_watt=rise, rise_s=1.0).v_ab)[0]
        for s, rise in ((warm, 0.0), (warm, 0.1))
    )
    expected = 1.0 + 0.1 * 10.0 * (1.0 - math.exp(-3.0))
    np.testing.assert_allclose(hot, expected * cold, rtol=1e-4)


@pytest.mark.parametrize(("at_edges", "times"), [(0.0, 1.0), (0.5, 1.5), (1.0, 2.0)])
def test_a_bias_of_the_gate_drivers_delays_grows_with_the_pwm_frequency(at_edges: float, times: float) -> None:
    own, twice = (
        signals.v_ab - corrected(VoltageBias(), signals, bias_a_v=0.2, bias_b_v=-0.1, at_edges=at_edges).v_ab
        for signals in (readings(), readings(pwm_hz=2.0 * FS))
    )
    assert_close(own, np.tile([0.2, 0.0], (400, 1)), 1e-9)
    assert_close(twice, times * own, 1e-9)
