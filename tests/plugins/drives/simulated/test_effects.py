"""Each effect of the catalogue does to the measurement what the catalogue says: sign and size."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive
from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._energy import hessian
from protocols import GatesOff, Hold
from tests.plugins.drives.simulated.conftest import Bench, rows
from tests.plugins.drives.simulated.test_plant import FS, plant_of, simulate

R = 4.25
CLARKE = np.array([[2.0, -1.0, -1.0], [0.0, math.sqrt(3.0), -math.sqrt(3.0)]]) / 3.0
PHASES = np.array([[1.0, 0.0], [-0.5, math.sqrt(0.75)], [-0.5, -math.sqrt(0.75)]])
I = np.array([2.0, 1.0])  # noqa: E741  no phase current near zero


def steady_voltage(drive: SimulatedDrive, i_dq: np.ndarray = I, pwm: float | None = None) -> np.ndarray:
    """Mean voltage that holds a current, believed dq frame (angle 0)."""
    hold = Hold(current_d_a=i_dq[0], current_q_a=i_dq[1], settle_s=1.0, duration_s=0.1, pwm_frequency_hz=pwm)
    i, v = rows(drive, hold)
    assert i.mean(axis=0) == pytest.approx(i_dq, abs=2e-4)
    return np.asarray(v.mean(axis=0))


def state_of(drive: SimulatedDrive) -> np.ndarray:
    return drive._plant.memory.state


def first_step(effects: dict[str, Any], volts: tuple[float, float] = (10.0, 0.0)) -> np.ndarray:
    """Current one sample after a voltage step from rest."""
    v = np.zeros((12, 2))
    v[5:] = volts
    i, _ = simulate(plant_of(effects=effects), v)
    return np.asarray(i[6])


def test_without_effects_the_voltage_is_resistive(bench: Bench) -> None:
    assert steady_voltage(bench()) == pytest.approx(R * I, abs=1e-3)


def test_dead_time_is_a_step_in_each_phase_current_and_follows_the_pwm_frequency(bench: Bench) -> None:
    drive = bench(effects={"dead_time": {"voltage_v": 8.0}})
    lost = 8.0 * CLARKE @ np.sign(PHASES @ I)
    assert steady_voltage(drive) - R * I == pytest.approx(lost, abs=5e-3)
    assert steady_voltage(drive, pwm=20_000.0) - R * I == pytest.approx(2 * lost, abs=5e-3)
    assert steady_voltage(drive, -I) + R * I == pytest.approx(-lost, abs=5e-3)


def test_dead_time_is_soft_below_its_threshold(bench: Bench) -> None:
    drive = bench(effects={"dead_time": {"voltage_v": 8.0, "threshold_a": 0.2}})
    lost = steady_voltage(drive, np.array([0.0, 0.05])) - R * np.array([0.0, 0.05])
    x = 0.05 * math.sqrt(0.75) / 0.2
    assert lost[1] == pytest.approx(8.0 * 2 / math.sqrt(3.0) * (1.5 * x - 0.5 * x**3), rel=2e-2)


def test_device_drop_is_the_same_at_every_pwm_frequency(bench: Bench) -> None:
    drive = bench(effects={"device_drop": {"voltage_v": 1.0, "on_resistance_ohm": 0.2}})
    lost = 1.0 * CLARKE @ np.sign(PHASES @ I) + 0.2 * I
    assert steady_voltage(drive) - R * I == pytest.approx(lost, abs=2e-3)
    assert steady_voltage(drive, pwm=20_000.0) - R * I == pytest.approx(lost, abs=2e-3)


def test_bus_sag_takes_a_share_in_proportion_to_the_power_and_shows_in_v_dc(bench: Bench) -> None:
    drive = bench(effects={"bus_sag": {"per_watt": 1e-4}}, dc_bus_voltage_v=540.0)
    v = steady_voltage(drive)
    power = 1.5 * float(v @ I)
    assert v * (1 - 1e-4 * power) == pytest.approx(R * I, abs=2e-3)
    assert drive.telemetry().v_dc_v == pytest.approx(540.0 * (1 - 1e-4 * power), abs=0.01)


def test_voltage_delay_shortens_the_first_sample_after_an_edge() -> None:
    assert first_step({"voltage_delay": {"delay_s": 2e-5}})[0] / first_step({})[0] == pytest.approx(0.8, abs=2e-3)


def test_current_filter_lags_behind_a_ramp_by_its_time_constant() -> None:
    v = np.tile([10.0, 0.0], (40, 1))
    late, _ = simulate(plant_of(effects={"current_filter": {"time_constant_s": 2e-5}}), v)
    true, _ = simulate(plant_of(), v)
    slope = (true[30] - true[28]) / 2 * FS
    assert true[29, 0] - late[29, 0] == pytest.approx(2e-5 * slope[0], rel=1e-2)


def test_current_gain_mismatch_is_between_the_phases(bench: Bench) -> None:
    drive = bench(effects={"current_gain_mismatch": {"gain_a_minus_b": 0.02}})
    i_a, i_b, _ = PHASES @ I
    true = np.array([i_a / 1.01, i_b / 0.99, -i_a / 1.01 - i_b / 0.99])
    assert steady_voltage(drive) == pytest.approx(R * CLARKE @ true, abs=2e-3)


def test_phase_resistance_imbalance_is_extra_volts_in_its_phases(bench: Bench) -> None:
    drive = bench(effects={"phase_resistance_imbalance": {"extra_a_ohm": 0.2, "extra_b_ohm": 0.1}})
    lost = CLARKE @ (np.array([0.2, 0.1, 0.0]) * (PHASES @ I))
    assert steady_voltage(drive) - R * I == pytest.approx(lost, abs=2e-3)


def test_current_offset_shows_with_the_gates_off_and_a_voltage_bias_does_not(bench: Bench) -> None:
    offset = CLARKE @ np.array([0.02, -0.01, -0.01])
    drive = bench(effects={"current_offset": {"offset_a_a": 0.02, "offset_b_a": -0.01}})
    i, v = rows(drive, GatesOff(duration_s=0.1))
    assert i.mean(axis=0) == pytest.approx(offset, abs=1e-5)
    assert not v.any()
    assert steady_voltage(drive) == pytest.approx(R * (I - offset), abs=1e-3)
    biased = bench(effects={"voltage_bias": {"bias_a_v": 0.2, "bias_b_v": -0.1}})
    i, _ = rows(biased, GatesOff(duration_s=0.1))
    assert np.abs(i).max() < 1e-6
    assert steady_voltage(biased) - R * I == pytest.approx(CLARKE @ np.array([0.2, -0.1, -0.1]), abs=1e-3)


def test_current_nonlinearity_is_cubic_in_each_phase(bench: Bench) -> None:
    drive = bench(effects={"current_nonlinearity": {"cubic_per_a2": 1e-3}})
    read = PHASES @ I
    true = read.copy()
    for _ in range(20):
        true = read - 1e-3 * true**3
    expected = CLARKE @ np.array([true[0], true[1], -true[0] - true[1]])
    assert steady_voltage(drive) == pytest.approx(R * expected, abs=2e-3)


def test_winding_heating_raises_the_resistance_with_the_loss_through_a_lag(bench: Bench) -> None:
    drive = bench(effects={"winding_heating": {"rise_per_watt": 1e-3, "time_constant_s": 0.2}})
    loss = 1.5 * R * float(I @ I)
    hot = steady_voltage(drive)[0] / I[0] / R
    assert hot == pytest.approx(1 / (1 - 1e-3 * loss), rel=2e-3)  # the hotter copper heats more


def test_skin_effect_is_there_for_the_ripple_only(bench: Bench) -> None:
    drive = bench(effects={"skin_effect": {"extra_ohm": 2.0}})
    assert steady_voltage(drive) == pytest.approx(R * I, abs=1e-3)
    assert ripple_resistance({"skin_effect": {"extra_ohm": 2.0}}) - ripple_resistance({}) == pytest.approx(
        2.0, rel=0.05
    )


def ripple_resistance(effects: dict[str, Any]) -> float:
    """Part of the impedance at 500 Hz that is in phase with the current [ohm]."""
    n = np.arange(4000)
    v = np.column_stack((10.0 * np.sin(2 * math.pi * 500.0 * (n + 0.5) / FS), np.zeros(len(n))))
    i, _ = simulate(plant_of(effects=effects), v)
    carrier = np.exp(-2j * math.pi * 500.0 * n[2000:] / FS)
    z = (v[2000:, 0] * np.exp(-2j * math.pi * 500.0 * (n[2000:] + 0.5) / FS)).sum() / (i[2000:, 0] * carrier).sum()
    return float(z.real)


def test_eddy_currents_are_in_step_with_the_voltage() -> None:
    step = first_step({"eddy_currents": {"core_loss_ohm": 1000.0}}) - first_step({})
    assert step[0] == pytest.approx(10.0 / 1000.0, rel=0.03)  # less the resistive drop


def loop(half_width_a: float, ratio: float, swing_wb: float) -> tuple[float, float]:
    """(half width at the middle [A], slope [A/Wb]) of a steady loop on the q axis of a linear motor."""
    linear: dict[str, Any] = {"magnetics": {"kind": "nameplate", "d_fall": 0.0, "q_fall": 0.0, "cross": 0.0}}
    effects = {"hysteresis": {"half_width_a": half_width_a, "reversible_ratio": ratio}}
    plant = plant_of(effects=effects, resistance_ohm=1e-9, **linear)
    period = 400
    n = np.arange(5 * period // 2)
    v = np.where((n + period // 4) // (period // 2) % 2 == 0, 1.0, -1.0) * swing_wb * FS / (period / 4)
    i, _ = simulate(plant, np.column_stack((np.zeros(len(n)), v)))
    psi = np.concatenate(([0.0], np.cumsum(v)[:-1] / FS))
    last = slice(len(n) - period, len(n))
    rising = v[last] > 0
    middle = np.abs(psi[last]) < 0.02 * swing_wb
    up, down = i[last, 1][rising & middle].mean(), i[last, 1][~rising & middle].mean()
    return 0.5 * (up - down), float(np.ptp(i[last, 1]) / np.ptp(psi[last]))


def test_hysteresis_has_the_width_and_the_small_loops_that_were_requested() -> None:
    width, large = loop(0.05, 0.93, 0.2)
    assert width == pytest.approx(0.05, rel=0.02)
    _, small = loop(0.05, 0.93, 0.0005)
    assert large / small == pytest.approx(0.93, abs=0.02)


def test_misalignment_couples_the_axes_in_the_believed_frame(bench: Bench) -> None:
    delta = math.radians(2.0)
    drive = bench(effects={"rotor_misalignment": {"angle_rad": delta}})
    assert state_of(drive)[layout.THETA] == pytest.approx(delta)
    h_dd, _, h_qq = hessian(*drive._plant.plant.magnetics, 0.3, 0.0)
    turn = np.array([[math.cos(delta), -math.sin(delta)], [math.sin(delta), math.cos(delta)]])
    believed = np.linalg.inv(turn @ np.diag([h_dd, h_qq]) @ turn.T)
    assert believed[0, 1] == pytest.approx((0.04325 - 0.06905) * delta, rel=5e-3)


def test_the_brake_gives_way_in_proportion_to_the_torque(bench: Bench) -> None:
    drive = bench(effects={"brake_compliance": {"rad_per_nm": 0.01}})
    steady_voltage(drive, np.array([0.0, 2.0]))
    twisted = float(state_of(drive)[layout.THETA])
    assert twisted == pytest.approx(0.01 * float(state_of(drive)[layout.TORQUE]), rel=1e-3)
    assert 0.01 < twisted < 0.03


def test_magnet_heating_slides_the_flux_without_a_voltage(bench: Bench) -> None:
    drive = bench(effects={"magnet_heating": {"flux_change_wb": -0.01, "time_constant_s": 0.05}})
    v = steady_voltage(drive, np.array([0.5, 0.5]))
    assert v == pytest.approx(R * np.array([0.5, 0.5]), abs=1e-3)
    still = bench()
    steady_voltage(still, np.array([0.5, 0.5]))
    moved = state_of(drive)[layout.PSI_D] - state_of(still)[layout.PSI_D]
    assert moved == pytest.approx(-0.01, rel=0.1)


def test_slot_harmonics_break_parity_at_a_fixed_angle() -> None:
    effects = {"slot_harmonics": {"relative": 0.05}}
    cross = first_step(effects)[1] / first_step(effects)[0]
    assert cross == pytest.approx(0.05 * math.sin(math.pi / 4), rel=0.35)
    assert abs(first_step({})[1]) < 1e-9


def test_noise_of_alpha_and_beta_is_that_of_two_phase_sensors(bench: Bench) -> None:
    drive = bench(noise=True, plant={"sensors": {"noise_a": 0.004, "quantum_a": 0.0}})
    i, _ = rows(drive, GatesOff(duration_s=5.0))
    covariance = np.cov(i.T)
    expected = 0.004**2 * np.array([[1.0, 1 / math.sqrt(3.0)], [1 / math.sqrt(3.0), 5.0 / 3.0]])
    assert covariance == pytest.approx(expected, rel=0.05)


def test_currents_come_in_quanta(bench: Bench) -> None:
    drive = bench(plant={"sensors": {"noise_a": 0.01, "quantum_a": 0.001}})
    i, _ = rows(drive, GatesOff(duration_s=0.1))
    assert np.abs(i[:, 0] / 0.001 - np.round(i[:, 0] / 0.001)).max() < 1e-3
    assert len(np.unique(i[:, 0])) > 20
