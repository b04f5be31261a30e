"""Each correction undoes the catalogue's equation: right sign, right size, right units."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.diagnosis.weak_form.segments import delayed, late_beside
from orchestrator.numerics.types import Array
from plugins.effects.frame import BrakeBacklash, BrakeCompliance, RotorMisalignment
from plugins.effects.inverter import BusSag, DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis, MagnetHeating
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
from protocols import DriveRecord, Effect, LossHistory, Motor, RealArray, Signals
from tests.support.close import assert_close

FS = 10_000.0


def _signals(n: int = 400, pwm_hz: float = FS) -> Signals:
    k = np.arange(n)
    i = np.stack([2.0 * np.cos(2 * np.pi * k / n), 1.5 * np.sin(2 * np.pi * k / n)], axis=1)
    v = 4.0 * i + np.where(k % 20 < 10, 40.0, -40.0)[:, None] * np.array([1.0, 0.5])
    return Signals(
        start_s=5.0,
        sampling_frequency_hz=FS,
        pwm_frequency_hz=pwm_hz,
        i_ab=i,
        v_ab=v,
        v_dc=np.full(n, 540.0),
        theta_rad=np.full(n, 0.2),
        resistance_ohm=np.full(n, 4.0),
        i_m_ab=i,
        heat_j=np.linspace(10.0, 20.0, n),
        motor=Motor(name="m", pole_pairs=2, d_inductance_h=0.043, q_inductance_h=0.069),
        drive=DriveRecord(name="d", sampling_frequency_hz=FS, pwm_frequency_hz=FS, dc_bus_voltage_v=540.0),
    )


def _corrected(effect: Effect, signals: Signals, **values: float) -> Signals:
    return signals.corrected(effect.correct(signals, effect.Parameters(**values)))


def _two(i_ab: RealArray) -> Array:
    """Phases a and b."""
    return np.stack([i_ab[:, 0], -0.5 * i_ab[:, 0] + math.sqrt(0.75) * i_ab[:, 1]], axis=1)


def _from_two(i_two: Array) -> Array:
    return np.stack([i_two[:, 0], (i_two[:, 0] + 2.0 * i_two[:, 1]) / math.sqrt(3.0)], axis=1)


def _reads(signals: Signals, i_ab: Array) -> Signals:
    return signals.model_copy(update={"i_ab": i_ab, "i_m_ab": i_ab})


def test_dead_time_opposes_the_current_and_grows_with_the_pwm_frequency() -> None:
    for pwm_hz, volts in ((FS, 8.0), (2 * FS, 16.0)):
        signals = _signals(pwm_hz=pwm_hz)
        lost = signals.v_ab - _corrected(DeadTime(), signals, voltage_v=8.0, threshold_a=0.01).v_ab
        # At the start i_a > 0 > i_b = i_c: the vector is 4/3 V along a.
        assert lost[0, 0] == pytest.approx(4.0 / 3.0 * volts, rel=0.01)


def test_voltage_bias_is_subtracted() -> None:
    signals = _signals()
    out = _corrected(VoltageBias(), signals, bias_a_v=0.3, bias_b_v=-0.15)
    assert_close(signals.v_ab - out.v_ab, np.tile([0.3, 0.0], (400, 1)), 1e-15, of=signals.v_ab)


def test_bus_sag_lowers_the_voltage_by_the_power() -> None:
    signals = _signals()
    out = _corrected(BusSag(), signals, per_watt=1e-3)
    power = 1.5 * np.sum(signals.v_ab[0] * 0.5 * (signals.i_ab[0] + signals.i_ab[1]))
    np.testing.assert_allclose(out.v_ab[0], signals.v_ab[0] * (1 - 1e-3 * power))


def test_delay_mixes_in_the_voltage_of_the_interval_before() -> None:
    signals = _signals()
    out = _corrected(VoltageDelay(), signals, delay_s=25e-6)
    np.testing.assert_allclose(out.v_ab[10], 0.75 * signals.v_ab[10] + 0.25 * signals.v_ab[9])


def test_sensor_errors_are_undone() -> None:
    signals = _signals()
    true = _two(signals.i_ab)
    gained = _reads(signals, _from_two(true * np.array([1.01, 0.99])))
    assert_close(_corrected(CurrentGainMismatch(), gained, gain_a_minus_b=0.02).i_ab, signals.i_ab, 1e-14)
    offset = _reads(signals, _from_two(true + np.array([0.02, -0.01])))
    read = _corrected(CurrentOffset(), offset, offset_a_a=0.02, offset_b_a=-0.01)
    assert_close(read.i_m_ab, signals.i_ab, 1e-14)
    bent = _reads(signals, _from_two(true + 3e-4 * true**3))
    assert_close(_corrected(CurrentNonlinearity(), bent, cubic_per_a2=3e-4).i_ab, signals.i_ab, 1e-7)


def _of_three(signals: Signals, i_abc: Array) -> Signals:
    """As a drive of three sensors reads it: the vector is the Clarke transform of all."""
    a, b, c = i_abc.T
    read = _reads(signals, np.stack([(2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)], axis=1))
    return read.model_copy(update={"i_abc": i_abc, "clarke_of_three": True})


def test_errors_of_three_sensors_are_undone() -> None:
    signals = _signals()
    a, b = _two(signals.i_ab).T
    true = np.stack([a, b, -a - b], axis=1)
    gained = _of_three(signals, true * np.array([1.0, 1.0, 1.01]))
    assert_close(_corrected(ThirdCurrentSensor(), gained, gain_c_minus_1=0.01).i_ab, signals.i_ab, 1e-14)
    gained = _of_three(signals, true * np.array([1.01, 0.99, 1.0]))
    assert_close(_corrected(CurrentGainMismatch(), gained, gain_a_minus_b=0.02).i_m_ab, signals.i_ab, 1e-14)
    offset = _of_three(signals, true + np.array([0.03, 0.0, 0.01]))
    assert_close(_corrected(CurrentOffset(), offset, offset_a_a=0.02, offset_b_a=-0.01).i_ab, signals.i_ab, 1e-14)
    bent = _of_three(signals, true + 3e-4 * true**3)
    assert_close(_corrected(CurrentNonlinearity(), bent, cubic_per_a2=3e-4).i_ab, signals.i_ab, 1e-5)


def test_a_third_sensor_that_is_known_not_to_be_there_has_no_error() -> None:
    signals = _signals().model_copy(update={"clarke_of_three": False})
    assert not ThirdCurrentSensor().shows_in(signals)
    assert _corrected(ThirdCurrentSensor(), signals, gain_c_minus_1=0.01) is signals


def test_resistance_goes_with_the_thermometer_from_its_first_reading() -> None:
    warm = _signals().model_copy(update={"temperature_c": np.full(400, 35.0), "start_temperature_c": 25.0})
    out = _corrected(ResistanceWithTemperature(), warm, per_k=0.004)
    np.testing.assert_allclose(out.resistance_ohm, 4.0 * 1.04)
    assert ResistanceWithTemperature().shows_in(warm)
    assert not ResistanceWithTemperature().shows_in(_signals())


def test_a_drift_grows_with_the_time_since_the_start_and_settles() -> None:
    signals = _signals()
    now = 5.0 + np.arange(400) / FS
    rates = np.array([2e-4, -1e-4])
    drifted = _reads(signals, signals.i_ab + _from_two(now[:, None] * rates))
    read = _corrected(CurrentOffsetDrift(), drifted, rate_a_a_per_s=2e-4, rate_b_a_per_s=-1e-4)
    assert_close(read.i_ab, signals.i_ab, 1e-13)
    assert_close(read.i_m_ab, signals.i_ab, 1e-13)
    settled = _corrected(CurrentOffsetDrift(), signals, rate_a_a_per_s=2e-4, settling_per_s=1.0)
    grown = _two(signals.i_ab - settled.i_ab)[:, 0]
    assert_close(grown, 2e-4 * (1.0 - np.exp(-now)), 1e-9)


def test_sensor_lag_is_undone_on_a_triangle() -> None:
    signals = _signals()
    true = np.stack([0.5 * np.abs(np.arange(400) % 20 - 10.0), np.zeros(400)], axis=1)
    tau = 8e-6
    slope = np.diff(true, axis=0, prepend=true[:1] - (true[1:2] - true[:1])) * FS
    out = _corrected(CurrentFilter(), _reads(signals, true - tau * slope), time_constant_s=tau)
    assert np.abs(out.i_ab - true)[1:].max() < 0.1 * tau * np.abs(slope).max() * 2


@pytest.mark.parametrize("samples", [0.2, 1.0, 3.0])
def test_sensor_lag_of_any_length_is_undone_where_the_true_course_is_known(samples: float) -> None:
    """The sensor's own equation in small steps, the current being straight between samples."""
    signals, fine = _signals(), 500
    true = np.stack([0.5 * np.abs(np.arange(400) % 20 - 10.0), np.zeros(400)], axis=1)
    read = true.copy()
    reading = float(true[0, 0])
    for k in range(1, 400):
        for x in true[k - 1, 0] + (true[k, 0] - true[k - 1, 0]) * (np.arange(fine) + 0.5) / fine:
            reading += (x - reading) / (samples * fine)
        read[k, 0] = reading
    known = _reads(signals, read).model_copy(update={"i_smooth_ab": true})
    out = _corrected(CurrentFilter(), known, time_constant_s=samples / FS)
    # By half an explicit step, in which the current moves by so much.
    assert np.abs(out.i_ab - true).max() < np.abs(np.diff(true, axis=0)).max() / fine


def test_a_smooth_current_that_ran_away_does_not_take_the_reading_along() -> None:
    signals = _signals()
    away = signals.model_copy(update={"i_smooth_ab": 1e4 * np.random.default_rng(3).normal(size=(400, 2))})
    change = _corrected(CurrentFilter(), away, time_constant_s=8e-6).i_ab - signals.i_ab
    assert np.abs(change).max() <= 8e-6 * FS * 3.0 * np.ptp(signals.i_ab, axis=0).max()


def test_extra_resistance_drops_in_its_own_phase() -> None:
    signals = _signals()
    out = _corrected(PhaseResistanceImbalance(), signals, extra_a_ohm=0.3, extra_b_ohm=0.0)
    mean = 0.5 * (signals.i_ab[0] + signals.i_ab[1])
    assert_close(signals.v_ab[0] - out.v_ab[0], [0.3 * mean[0] * 2.0 / 3.0, 0.0], 1e-15, of=signals.v_ab)


def test_heating_reaches_its_steady_rise() -> None:
    losses = LossHistory(time_s=np.linspace(0.0, 5000.0, 2001), power_w=np.full(2001, 20.0), captured=np.ones(2001))
    signals = _signals().model_copy(update={"losses": losses, "start_s": 4900.0})
    out = _corrected(WindingHeating(), signals, rise_per_watt=0.003, time_constant_s=150.0)
    # 20 W warm it by 6 %, and the warmer winding loses more: y = 0.06 (1 + y).
    assert out.resistance_ohm[0] / 4.0 == pytest.approx(1.0 + 0.06 / (1.0 - 0.06), abs=2e-5)


def test_misalignment_is_true_minus_believed() -> None:
    out = _corrected(RotorMisalignment(), _signals(), angle_rad=-0.03)
    assert out.theta_rad[0] == pytest.approx(0.17)


def test_a_brake_with_play_lies_at_the_end_that_the_torque_points_to() -> None:
    signals = _signals()
    flux = 0.3 * np.array([math.cos(0.2), math.sin(0.2)])
    quarter = np.array([-math.sin(0.2), math.cos(0.2)])
    for q in (2.0, -2.0, 1e-3):
        at = signals.model_copy(update={"psi_ab": np.tile(flux, (400, 1)), "i_ab": np.tile(q * quarter, (400, 1))})
        turned = _corrected(BrakeBacklash(), at, gap_rad=0.01, friction_nm=0.05, lag_s=1e-3).theta_rad - 0.2
        torque = 1.5 * 2 * 0.3 * q
        expected = 0.005 * torque / math.hypot(torque, 0.05)
        assert_close(turned, np.full(400, expected), 1e-9, of=[0.01])


def test_brake_twists_with_the_torque() -> None:
    signals = _signals()
    axis = np.array([math.cos(0.2), math.sin(0.2)])
    psi = np.tile(0.3 * axis, (400, 1))
    out = _corrected(BrakeCompliance(), signals.model_copy(update={"psi_ab": psi}), rad_per_nm=0.005)
    i_q = -math.sin(0.2) * signals.i_ab[0, 0] + math.cos(0.2) * signals.i_ab[0, 1]
    assert out.theta_rad[0] - 0.2 == pytest.approx(0.005 * 1.5 * 2 * 0.3 * i_q)


@pytest.mark.parametrize("hz", [20.0, 159.0, 700.0])
def test_a_rotor_swings_on_its_brake_as_a_spring_with_inertia_and_friction(hz: float) -> None:
    """The torque's amplitude and phase, 1 / (1 + j w lag - w^2 inertia), once what began it has died away."""
    n, lag_s, inertia_s2 = 4000, 4e-4, 1e-6
    omega = 2.0 * math.pi * hz
    time_s = np.arange(n) / FS
    along = np.stack([np.cos(np.full(n, 0.2)), np.sin(np.full(n, 0.2))], axis=1)
    signals = _reads(_signals(n), np.sin(omega * time_s)[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1))
    signals = signals.model_copy(update={"psi_ab": 0.3 * along})
    out = _corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=inertia_s2)
    twist = 0.005 * 1.5 * 2 * 0.3 / (1.0 + 1j * omega * lag_s - omega**2 * inertia_s2)
    expected = np.imag(twist * np.exp(1j * omega * time_s))
    # A reading every 14th of a period is a chord of the sine.
    assert_close((out.theta_rad - 0.2)[n // 2 :], expected[n // 2 :], 0.02, of=[abs(twist)])
    light = _corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=1e-14)
    without = _corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s)
    assert_close(light.theta_rad, without.theta_rad, 1e-6, of=[abs(twist)])


@given(
    hz=st.floats(1e3, 1e5),
    lag_s=st.floats(math.log(1e-5), math.log(0.1)).map(math.exp),
    inertia_s2=st.floats(math.log(1e-30), math.log(1e-3)).map(math.exp),
)
def test_a_rotor_at_rest_stays_at_rest_whatever_its_inertia(hz: float, lag_s: float, inertia_s2: float) -> None:
    along = np.tile([math.cos(0.2), math.sin(0.2)], (400, 1))
    signals = _reads(_signals(), 2.0 * np.stack([-along[:, 1], along[:, 0]], axis=1))
    signals = signals.model_copy(update={"psi_ab": 0.3 * along, "sampling_frequency_hz": hz})
    out = _corrected(BrakeCompliance(), signals, rad_per_nm=0.005, lag_s=lag_s, inertia_s2=inertia_s2)
    assert_close(out.theta_rad - 0.2, np.full(400, 0.005 * 1.5 * 2 * 0.3 * 2.0), 1e-6, of=[0.01])


def test_eddy_current_follows_the_voltage_before_the_sample() -> None:
    signals = _signals()
    out = _corrected(EddyCurrents(), signals, core_loss_ohm=1000.0)
    eddy = (signals.v_ab[9] - 4.0 * signals.i_ab[10]) / 1000.0
    np.testing.assert_allclose(signals.i_m_ab[10] - out.i_m_ab[10], eddy)


@pytest.mark.parametrize("lag_s", [5e-6, 8e-5, 5e-4])
def test_a_late_eddy_current_bends_between_samples_as_an_exponential(lag_s: float) -> None:
    """Its mean over an interval, beside the mean of both ends, is in the resistive drop that the voltage loses."""
    v = np.random.default_rng(2).normal(size=(400, 2))
    signals = _signals().model_copy(update={"v_ab": v, "i_ab": np.zeros((400, 2)), "i_m_ab": np.zeros((400, 2))})
    out = _corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, lag_s=lag_s)
    eddy = -out.i_m_ab
    decay = math.exp(-1.0 / (lag_s * FS))
    mean = v / 1000.0 + (eddy - v / 1000.0) * lag_s * FS * (1.0 - decay)
    after = v / 1000.0 + (eddy - v / 1000.0) * decay
    bend = 4.0 * (mean - 0.5 * (eddy + after))
    assert_close((v - out.v_ab)[:-1], bend[:-1], 1e-9, of=bend)
    assert_close(eddy[1:], after[:-1], 1e-12, of=eddy)


@pytest.mark.parametrize(("lag_s", "part", "within"), [(0.0, 0.3, 1e-9), (5e-5, 0.5, 1e-9), (5e-5, 0.2, 0.1)])
def test_eddies_behind_a_late_voltage_follow_what_it_was_at_the_reading(
    lag_s: float, part: float, within: float
) -> None:
    """Beside an exponential through both voltages of each interval: exact without a lag, and at half of one."""
    v = np.random.default_rng(2).normal(size=(400, 2))
    nil = np.zeros((400, 2))
    signals = _signals().model_copy(update={"v_ab": v, "i_ab": nil, "i_m_ab": nil})
    late = _corrected(VoltageDelay(), signals, delay_s=part / FS)
    eddy = -1000.0 * _corrected(EddyCurrents(), late, core_loss_ohm=1000.0, lag_s=lag_s).i_m_ab
    old, new = (math.exp(-share / (lag_s * FS)) if lag_s > 0.0 else 0.0 for share in (part, 1.0 - part))
    expected = np.zeros((400, 2))
    for k in range(1, 399):
        midway = v[k - 1] + (expected[k] - v[k - 1]) * old
        expected[k + 1] = v[k] + (midway - v[k]) * new
    assert_close(eddy[60:], expected[60:], within, of=expected)


def test_a_delay_that_the_drive_declares_is_felt_as_one_that_is_found() -> None:
    signals = _signals()
    found = _corrected(VoltageDelay(), signals, delay_s=0.4 / FS)
    command = np.asarray(signals.v_ab, dtype=np.float64)
    beside = late_beside(command, 0.4)
    assert beside is not None
    assert found.v_late_ab is not None
    assert_close(delayed(command, 0.4), found.v_ab, 1e-12, of=found.v_ab)
    assert_close(beside, found.v_late_ab, 1e-12, of=found.v_ab)
    assert late_beside(command, 1.0) is None


def test_what_eddies_feel_of_a_small_delay_is_small() -> None:
    """Early or late: a search walks through none at all without a step."""
    signals = _signals()
    felt = [
        _corrected(EddyCurrents(), _corrected(VoltageDelay(), signals, delay_s=by), core_loss_ohm=1000.0).i_m_ab
        for by in (-1e-9, 0.0, 1e-9)
    ]
    assert_close(felt[0], felt[1], 1e-4, of=signals.i_m_ab)
    assert_close(felt[2], felt[1], 1e-4, of=signals.i_m_ab)


def test_a_damper_may_be_on_one_axis_alone() -> None:
    signals = _signals()
    axis_d = np.array([math.cos(0.2), math.sin(0.2)])
    both = signals.i_m_ab - _corrected(EddyCurrents(), signals, core_loss_ohm=1000.0).i_m_ab
    damped = signals.i_m_ab - _corrected(EddyCurrents(), signals, core_loss_ohm=1000.0, saliency=1.0).i_m_ab
    assert_close(damped @ axis_d, 2.0 * both @ axis_d, 1e-12, of=both)
    assert np.abs(damped @ np.array([-axis_d[1], axis_d[0]])).max() < 1e-12 * np.abs(both).max()


def _loop(values: dict[str, float], swing_wb: float) -> tuple[Array, Array]:
    k = np.arange(4000)
    psi = np.stack([swing_wb * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    signals = _signals(4000).model_copy(update={"psi_smooth_ab": psi})
    held = signals.i_m_ab - _corrected(Hysteresis(), signals, **values).i_m_ab
    return psi[:, 0], held[:, 0]


def test_hysteresis_loop_is_as_wide_as_said_and_loses_energy() -> None:
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015}, 0.2)
    assert held.max() == pytest.approx(0.03, rel=1e-6)
    assert held.min() == pytest.approx(-0.03, rel=1e-6)
    area = float(np.sum(0.5 * (held[3000:-1] + held[3001:]) * np.diff(psi[3000:])))
    assert area > 0.0


def test_small_hysteresis_loops_are_reversible() -> None:
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015}, 0.001)
    slope = np.polyfit(psi, held, 1)[0]
    assert slope == pytest.approx(0.03 / 0.015, rel=1e-6)


def test_a_hysteresis_loop_keeps_its_form_whatever_its_width() -> None:
    """So the step from none says what any width does, and a search is not led astray by the typical one."""
    form = {"yield_wb": 0.015, "variance": 0.3, "early_share": 0.4, "softness": 0.5}
    wide, narrow = (_loop({"half_width_a": width, **form}, 0.02)[1] for width in (0.03, 0.001))
    assert_close(30.0 * narrow, wide, 1e-9, of=wide)


def test_stops_that_hold_out_alike_are_one_however_they_share_and_else_yield_apart() -> None:
    """What yields first is then no matter of which stop it is: a search is not trapped on the wrong side of none."""
    sizes = {"half_width_a": 0.03, "yield_wb": 0.015}
    psi, alike = _loop(sizes, 0.2)
    _, unequal = _loop({**sizes, "early_share": 0.8}, 0.2)
    assert_close(unequal, alike, 1e-12, of=alike)
    # 30 mA in all of 1.6 A/Wb: 10 mA of 1 A/Wb and 20 mA of 0.6 A/Wb yield at 10 and 33 mWb.
    two = {"early_share": 1.0 / 1.6, "variance": (0.5 * math.log(10.0 / 3.0)) ** 2}
    _, apart = _loop({"half_width_a": 0.03, "yield_wb": 0.03 / 1.6, **two}, 0.2)
    falling = slice(3250, 3750)
    fallen = apart[3250] - apart[falling]
    swing = psi[3250] - psi[falling]
    expected = np.minimum(1.0 * swing, 0.02) + np.minimum(0.6 * swing, 0.04)
    assert_close(fallen, expected, 0.02, of=expected)


def test_a_third_stop_yields_between_the_two() -> None:
    """Of 2 A/Wb half are the middle one's; the others yield at half and at twice its flux."""
    form = {"middle_share": 0.5, "variance": math.log(2.0) ** 2}
    psi, held = _loop({"half_width_a": 0.03, "yield_wb": 0.015, **form}, 0.2)
    stiff, yields = np.array([0.5, 1.0, 0.5]), np.array([0.5, 1.0, 2.0])
    limits = 0.03 * stiff * yields / (stiff @ yields)
    falling = slice(3250, 3750)
    swing = psi[3250] - psi[falling]
    expected = np.minimum(swing[:, None] * stiff, 2.0 * limits).sum(axis=1)
    assert_close(held[3250] - held[falling], expected, 0.02, of=expected)


def test_a_soft_stop_yields_before_its_limit_and_the_softer_the_sooner() -> None:
    sizes = {"half_width_a": 0.03, "yield_wb": 0.015}
    psi, sharp = _loop(sizes, 0.2)
    _, nearly = _loop({**sizes, "softness": 0.02}, 0.2)
    _, soft = _loop({**sizes, "softness": 0.6}, 0.2)
    _, softer = _loop({**sizes, "softness": 1.0}, 0.2)
    assert_close(nearly, sharp, 0.05, of=sharp)
    assert soft.max() == pytest.approx(0.03, rel=0.02)
    # On the way up, before the limit is reached, less is held the softer the stop; on the way back all are elastic.
    rising = (np.diff(psi, append=psi[:1]) > 0.0) & (sharp > 0.015) & (sharp < 0.025)
    assert rising[3000:].any()
    assert (softer < soft)[3000:][rising[3000:]].all()
    assert (soft < sharp)[3000:][rising[3000:]].all()
    turn = 3000 + 250
    stiff = (sharp[turn] - sharp[turn + 20]) / (psi[turn] - psi[turn + 20])
    assert (soft[turn] - soft[turn + 20]) / (psi[turn] - psi[turn + 20]) == pytest.approx(stiff, rel=1e-3)


def test_a_soft_stop_asks_how_far_the_flux_has_moved_and_not_in_how_many_steps() -> None:
    k = np.arange(4000)
    fine = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), 0.1 * np.cos(2 * np.pi * k / 1000)], axis=1)
    held = []
    for every in (1, 10):
        psi = np.ascontiguousarray(fine[::every])
        signals = _signals(len(psi)).model_copy(update={"psi_smooth_ab": psi, "came_from_ab": np.zeros((1, 2))})
        out = _corrected(Hysteresis(), signals, half_width_a=0.03, yield_wb=0.015, softness=0.6)
        held.append((signals.i_m_ab - out.i_m_ab)[:: 10 // every])
    assert_close(held[1][100:], held[0][100:], 0.03, of=held[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_iron_remembers_from_where_the_current_came(side: float) -> None:
    k = np.arange(4000)
    psi = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    signals = _signals(4000).model_copy(update={"psi_smooth_ab": psi})
    far = signals.i_ab[0] - side * np.array([3.0, 0.0])
    held = []
    for came_from in (far, signals.i_ab[0]):
        coming = signals.model_copy(update={"came_from_ab": came_from[None]})
        out = _corrected(Hysteresis(), coming, half_width_a=0.03, yield_wb=0.015)
        held.append((coming.i_m_ab - out.i_m_ab)[:, 0])
    assert held[0][0] == pytest.approx(side * 0.03, rel=0.05)
    assert held[1][0] == 0.0
    # After half a loop nothing is left of that.
    assert_close(held[0][1000:], held[1][1000:], 1e-9, of=held[0])


def _held_at_first(came_from: Array, **values: float) -> Array:
    """What a sharp stop holds as a segment begins that the current came to on this way, shape (2,) [A]."""
    psi = np.repeat([[0.2, 0.0]], 4000, axis=0)
    signals = _signals(4000).model_copy(update={"psi_smooth_ab": psi, "came_from_ab": came_from})
    out = _corrected(Hysteresis(), signals, half_width_a=0.03, yield_wb=0.015, **values)
    return np.asarray((signals.i_m_ab - out.i_m_ab)[0], dtype=np.float64)


def test_iron_remembers_a_sweep_before_a_way_that_is_too_short_to_wipe_it_out() -> None:
    here = _signals().i_ab[0]
    near, far = here - [0.01, 0.0], np.array([3.0, 0.0])
    below, above = (_held_at_first(np.array([here + side * far, near])) for side in (-1.0, 1.0))
    assert below[0] == pytest.approx(0.03, rel=0.05)
    assert above[0] == pytest.approx(-0.03, rel=0.1)


def test_a_controller_that_goes_beyond_its_aim_leaves_the_iron_on_the_other_branch() -> None:
    came_from = (_signals().i_ab[0] - [3.0, 0.0])[None]
    assert _held_at_first(came_from, overshoot=0.3)[0] == pytest.approx(-0.03, rel=0.05)
    # 15 mWb are 0.27 A or so: a hundredth of 3 A turns little of a loop.
    assert 0.02 < _held_at_first(came_from, overshoot=0.01)[0] < 0.03


def test_what_iron_may_remember_beside_its_way_stays_where_nothing_moves_and_is_gone_after_a_loop() -> None:
    k = np.arange(4000)
    loop = np.stack([0.2 * np.sin(2 * np.pi * k / 1000), np.zeros(4000)], axis=1)
    p = Hysteresis.Parameters(half_width_a=0.03, yield_wb=0.015, early_share=0.5)
    for psi, stays in ((np.repeat(loop[:1], 4000, axis=0), True), (loop, False)):
        signals = _signals(4000).model_copy(update={"psi_smooth_ab": psi, "came_from_ab": np.zeros((1, 2))})
        known = signals.corrected(Hysteresis().correct(signals, p)).i_m_ab
        doubts = [doubt.arrays["i_m_ab"] - signals.i_m_ab for doubt in Hysteresis().doubts(signals, p)]
        assert len(doubts) == 4
        for doubt in doubts:
            # No stop holds more than its limit, whatever it remembers.
            assert np.abs(doubt).max() <= 0.5 * 0.03 + 1e-12
            assert np.abs(signals.i_m_ab - known - doubt).max() <= 0.03 + 1e-12
            if stays:
                assert_close(doubt, np.broadcast_to(doubt[0], doubt.shape), 1e-12, of=0.03)
                assert np.linalg.norm(doubt[0]) > 1e-3
            else:
                assert_close(doubt[2000:, 0], np.zeros(2000), 1e-6, of=0.03)


def test_skin_effect_drops_what_its_two_corners_let_through() -> None:
    n, hertz = 20_000, 50.0
    turn = np.exp(2j * np.pi * hertz * np.arange(n) / FS)
    i_ab = np.stack([turn.real, turn.imag], axis=1)
    signals = _signals(n).model_copy(update={"i_ab": i_ab})
    v_ab = _corrected(SkinEffect(), signals, extra_ohm=2.0, corner_hz=60.0, variance=0.25, low_share=0.7).v_ab
    dropped = (signals.v_ab - v_ab) @ np.array([1.0, 1.0j])
    fast = 1.0 - 0.7 / (1.0 + 1j * hertz / (60.0 * math.exp(-0.5))) - 0.3 / (1.0 + 1j * hertz / (60.0 * math.exp(0.5)))
    middle = 0.5 * (turn[10_000:-1] + turn[10_001:])
    assert_close(dropped[10_000:-1], 2.0 * fast * middle, 0.01, of=2.0 * middle)


def test_magnets_warm_by_the_copper_loss_and_by_what_else_stays_as_it_is() -> None:
    time_s = np.linspace(0.0, 20.0, 201)
    late = LossHistory(time_s=time_s, power_w=np.where(time_s < 10.0, 0.0, 5.0))
    signals = _signals().model_copy(update={"losses": late})
    values = {"flux_change_wb": -0.0043, "time_constant_s": 8.0}
    slid = []
    for steady in (0.0, 1.0, 0.4):
        out = _corrected(MagnetHeating(), signals, **values, steady=steady)
        slid.append(((out.i_m_ab - signals.i_m_ab) @ [math.cos(0.2), math.sin(0.2)])[0])
    # At 5 s no copper has been warm; what stays as it is has come (1 - e^(-5/8)) / (1 - e^(-20/8)) of its way.
    whole = -0.0043 / 0.043
    assert slid[0] == pytest.approx(0.0, abs=1e-12)
    assert slid[1] == pytest.approx(whole * math.expm1(-5.0 / 8.0) / math.expm1(-20.0 / 8.0), rel=1e-2)
    assert slid[2] == pytest.approx(0.4 * slid[1], rel=1e-9)


def test_a_devices_drop_changes_with_what_its_leg_has_carried() -> None:
    time_s = np.linspace(0.0, 20.0, 401)
    late = LossHistory(time_s=time_s, power_w=np.where(time_s < 4.0, 0.0, 9.0))
    signals = _signals().model_copy(update={"losses": late})
    values = {"voltage_v": 0.8, "threshold_a": 0.03, "warming_s": 2.0}
    cold, warm = (signals.v_ab - _corrected(DeviceDrop(), signals, **values, warming=part).v_ab for part in (0.0, -0.1))
    # A second after the current came, of what sixteen make of it.
    part = math.expm1(-1.0 / 2.0) / math.expm1(-16.0 / 2.0)
    assert_close(warm[0], (1.0 - 0.1 * part) * cold[0], 1e-2 * part, of=cold[0])
    unknown = _signals()
    assert_close(_corrected(DeviceDrop(), unknown, **values, warming=-0.1).v_ab, unknown.v_ab - cold, 1e-12, of=cold)
