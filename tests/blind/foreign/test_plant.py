"""The second plant's forms against energy, limits and closed solutions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from plugins.effects.sensors import ShuntReconstruction
from protocols import Signals
from tests.blind.foreign.cases import hall_transition
from tests.blind.foreign.inverter import CHARGE_POINTS, CHARGE_REACH, charge_table, phase_loss
from tests.blind.foreign.iron import Array, Iron, tabulated
from tests.blind.foreign.machines import FAMILIES, Motor
from tests.blind.foreign.plant import BUS, CONTROL, HEAT, OPEN, PSI, STATES, TWIST, Plant, run
from tests.blind.foreign.preisach import DIRECTIONS, ROW, everett, half_width, held_current, remember

TS, R, L_D, L_Q, BUS_V, MAGNET = 1e-4, 4.0, 0.04, 0.07, 540.0, 0.3
PLAIN = Plant(TS, 4, 2.0, R, BUS_V, 0.0, 0.0)
LOOPS = everett(0.06, 0.5, 0.4)


@pytest.fixture(scope="module")
def linear() -> Iron:
    return tabulated(
        lambda x, y: np.asarray(0.5 * (x - MAGNET) ** 2 / L_D + 0.5 * y**2 / L_Q), (-0.2, 0.8), 0.6, points=41
    )


def respond(
    plant: Plant, iron: Iron, wanted: Array, mode: int = OPEN, believed: float = 0.0, **tables: Any
) -> tuple[Array, Array, Array]:
    """Currents and voltages in the believed frame, from rest, and the state in the end."""
    rows, y, memory = len(wanted), np.zeros(STATES), np.zeros((DIRECTIONS, ROW))
    y[PSI], y[PSI + 1] = iron.flux(0.0, 0.0)
    i, v = np.empty((rows, 2)), np.empty((rows, 2))
    gains = np.array([9.0, 15.0, 900.0, 1500.0])
    run(
        plant, iron.coefficients, iron.grid, tables.get("relays", np.zeros((2, 2))), memory,
        tables.get("charge", np.zeros(CHARGE_POINTS)), tables.get("hall", np.zeros((2, 4))), y, believed, mode, gains,
        np.asarray(wanted, dtype=np.float64), np.zeros((rows, 2)), np.zeros((rows, 3)), i, v,
    )  # fmt: skip
    turn = np.array([[np.cos(believed), -np.sin(believed)], [np.sin(believed), np.cos(believed)]])
    return i @ turn, v @ turn, y


def still(d: float, q: float, rows: int = 3000) -> Array:
    return np.tile([d, q], (rows, 1))


def work_of(i: Array, v: Array, rows: slice) -> float:
    """Energy that goes into the iron over whole periods [J]."""
    after = slice(rows.start + 1, rows.stop + 1)
    mean = 0.5 * (i[rows] + i[after])
    return float(1.5 * TS * (v[rows] * mean - R * mean**2).sum())


def test_a_healthy_linear_machine_answers_exponentially(linear: Iron) -> None:
    i, _, _ = respond(PLAIN, linear, still(8.0, 4.0, 400), believed=0.7)
    t = TS * np.arange(400)
    assert i[:, 0] == pytest.approx(8.0 / R * -np.expm1(-R * t / L_D), abs=1e-6)
    assert i[:, 1] == pytest.approx(4.0 / R * -np.expm1(-R * t / L_Q), abs=1e-6)


@pytest.fixture(scope="module", params=["ipm_bridges", "traction_bridges", "synrm"])
def motor(request: pytest.FixtureRequest) -> Motor:
    return FAMILIES[request.param]()


def test_a_network_is_reciprocal_for_small_signals(motor: Motor) -> None:
    top = motor.plate.top_a
    h = 1e-3 * top
    for d, q in ((-0.5, 0.4), (0.1, 0.05), (0.3, -0.8)):
        i_d, i_q = d * top, q * top
        by_q = (motor.iron.flux(i_d, i_q + h)[0] - motor.iron.flux(i_d, i_q - h)[0]) / (2 * h)
        by_d = (motor.iron.flux(i_d + h, i_q)[1] - motor.iron.flux(i_d - h, i_q)[1]) / (2 * h)
        l_dd, l_dq, l_qq = motor.iron.inductance(i_d, i_q)
        assert by_q == pytest.approx(by_d, abs=1e-4 * l_dd)
        assert by_q == pytest.approx(l_dq, abs=1e-3 * l_dd)
        assert l_dd * l_qq > l_dq**2


def test_bridges_saturate_within_a_tenth_of_the_current_range() -> None:
    for family in ("ipm_bridges", "traction_bridges"):
        motor = FAMILIES[family]()
        top = motor.plate.top_a
        unsaturated, saturated = (motor.iron.inductance(0.0, q * top)[2] for q in (0.0, 0.1))
        assert unsaturated > 1.5 * saturated
        beyond = motor.iron.inductance(0.0, 0.2 * top)[2]
        assert saturated < 1.15 * beyond
        bridge = max(motor.iron.inductance(d * top, 0.0)[0] for d in np.linspace(*motor.span_d, 60))
        assert bridge > 1.5 * motor.iron.inductance(motor.span_d[0] * top, 0.0)[0]


def test_a_machine_of_more_turns_has_the_same_energy_at_scaled_currents(motor: Motor) -> None:
    top = motor.plate.top_a
    psi = motor.iron.flux(0.4 * top, 0.3 * top)
    wound = motor.iron.scaled(1.2, 0.9).flux(0.9 * 0.4 * top, 0.9 * 0.3 * top)
    assert wound == pytest.approx([1.2 * psi[0], 1.2 * psi[1]])


def follow(path: Array) -> tuple[Array, Array]:
    """The held current along a path of flux, and what is remembered in the end."""
    memory, held = np.zeros((DIRECTIONS, ROW)), np.empty_like(path)
    for k, (d, q) in enumerate(path):
        remember(LOOPS, memory, 1.0, d, q)
        held[k] = held_current(LOOPS, memory, 1.0, 1.0, d, q)
    return held, memory


def dissipated(path: Array, held: Array) -> float:
    return float((0.5 * (held[1:] + held[:-1]) * np.diff(path, axis=0)).sum())


@pytest.mark.parametrize("size", [0.1, 0.4, 0.8])
def test_preisach_loops_take_energy_along_an_axis_and_in_rotation(size: float) -> None:
    t = np.linspace(0.0, 6 * np.pi, 3001)
    along = size * np.stack([np.sin(t), np.zeros_like(t)], axis=1)
    round_about = size * np.stack([np.cos(t), np.sin(t)], axis=1) * np.minimum(1.0, t / np.pi)[:, None]
    for path in (along, round_about):
        held, _ = follow(path)
        assert dissipated(path[1000:2001], held[1000:2001]) > 0.5 * size * np.abs(held).max()


def test_preisach_returns_to_a_point_after_a_closed_minor_loop() -> None:
    x = np.concatenate([np.linspace(0, 0.7, 50), np.linspace(0.7, -0.2, 50), np.linspace(-0.2, 0.3, 30)])
    back = np.concatenate([x, np.linspace(0.3, -0.2, 30), np.linspace(-0.2, -0.4, 20)])
    straight = np.concatenate([x[:100], np.linspace(-0.2, -0.4, 20)])
    with_loop, without = (follow(np.stack([way, np.zeros_like(way)], axis=1))[0] for way in (back, straight))
    assert with_loop[-21] == pytest.approx(with_loop[99], abs=1e-9)
    assert with_loop[-1] == pytest.approx(without[-1], abs=1e-9)


def test_a_trial_of_the_flux_changes_no_memory() -> None:
    _, memory = follow(np.array([[0.1, 0.2], [0.5, -0.3], [0.2, 0.1]]))
    before = memory[:, :3].copy()
    tried = held_current(LOOPS, memory, 1.0, 1.0, -0.1, 0.4)
    assert np.array_equal(memory[:, :3], before)
    remember(LOOPS, memory, 1.0, -0.1, 0.4)
    assert held_current(LOOPS, memory, 1.0, 1.0, -0.1, 0.4) == pytest.approx(tried)


def test_a_plant_with_hysteresis_takes_energy_and_holds_current(linear: Iron) -> None:
    plant = PLAIN._replace(held_a=0.05, held_per_wb=1.5, magnet_wb=MAGNET)
    t = TS * np.arange(12_000)
    wave = 35.0 * np.cos(2 * np.pi * 25.0 * t)[:, None] * [[0.0, 1.0]]
    i, v, _ = respond(plant, linear, wave, relays=LOOPS)
    plain, _, _ = respond(PLAIN, linear, wave)
    swing = np.ptp(plain[8000:, 1]) * L_Q / 2
    assert np.abs(i[8000:, 1] - plain[8000:, 1]).max() > 0.3 * 0.05 * half_width(LOOPS, 1.5 * swing)
    assert work_of(i, v, slice(8000, 11_600)) > 0.0


def test_half_order_eddy_losses_go_with_the_power_1_5_of_the_frequency(linear: Iron) -> None:
    losses = []
    for hz in (100.0, 400.0):
        t = TS * np.arange(6000)
        wave = 0.02 * 2 * np.pi * hz * np.cos(2 * np.pi * hz * t)[:, None] * [[0.0, 1.0]]
        plant = PLAIN._replace(resistance=0.0, eddy_siemens=4e-3, eddy_slow_s=1e-2)
        i, v, _ = respond(plant, linear, wave)
        mean = 0.5 * (i[2000:5000] + i[2001:5001])
        losses.append(float((v[2000:5000] * mean).mean()))
    assert losses[0] > 0.0
    assert losses[1] / losses[0] == pytest.approx(4.0**1.5, rel=0.15)


def test_dead_time_vanishes_without_current_and_is_whole_at_large_ones() -> None:
    table = charge_table(0.6, 0.1)

    def loss(i: float) -> float:
        return phase_loss(table, 8.0, 0.05, 0.0, 1.0, 1.0, i)

    assert loss(0.0) == 0.0
    assert loss(5.0) == pytest.approx(8.0, rel=0.01)
    assert loss(-0.03) == pytest.approx(-loss(0.03))
    assert np.all(np.diff([loss(i) for i in np.linspace(0, 1, 300)]) >= 0.0)
    edge = CHARGE_REACH * 0.05
    assert loss(1.0001 * edge) == pytest.approx(loss(0.9999 * edge), rel=1e-3)


def test_dead_time_costs_its_volts_at_a_held_current(linear: Iron) -> None:
    plant = PLAIN._replace(dead_v=3.0, dead_a=0.05)
    i, v, _ = respond(plant, linear, still(2.0, 0.0), CONTROL, charge=charge_table(0.6, 0.1))
    assert i[-1] == pytest.approx([2.0, 0.0], abs=2e-3)
    assert v[-1, 0] - R * 2.0 == pytest.approx(3.0 * 4 / 3, rel=0.02)


def test_a_knee_is_as_high_as_stated_at_its_current() -> None:
    per_asinh = 1.0 / np.arcsinh(3.0 / 0.02)
    assert phase_loss(np.zeros(CHARGE_POINTS), 0.0, 1.0, 0.9, 0.02, per_asinh, -3.0) == pytest.approx(-0.9)


def test_the_bus_sags_by_both_resistors(linear: Iron) -> None:
    plant = PLAIN._replace(line_ohm=20.0, line_f=2e-4, link_ohm=10.0, link_f=2e-5)
    i, v, y = respond(plant, linear, still(3.0, 0.0), CONTROL)
    drawn = 1.5 * R * i[-1, 0] ** 2 / BUS_V
    assert y[BUS] + y[BUS + 1] == pytest.approx(30.0 * drawn, rel=1e-2)
    assert v[-1, 0] * (1 - 30.0 * drawn / BUS_V) == pytest.approx(R * i[-1, 0], rel=1e-4)


def test_the_copper_warms_by_its_losses(linear: Iron) -> None:
    plant = PLAIN._replace(slot_k_per_w=0.3, copper_j_per_k=0.1, room_k_per_w=0.5, iron_j_per_k=0.4)
    i, v, y = respond(plant, linear, still(2.0, 0.0, 20_000), CONTROL)
    loss = 1.5 * v[-1, 0] * i[-1, 0]
    assert y[HEAT] == pytest.approx(0.8 * loss, rel=0.02)
    assert v[-1, 0] / i[-1, 0] == pytest.approx(R * (1 + 0.00393 * y[HEAT]), rel=1e-3)


def test_a_brake_twists_by_its_spring_and_sticks_by_its_bristles(linear: Iron) -> None:
    brake = PLAIN._replace(
        spring_per_nm=0.01, resonance=2000.0, damping=0.4, friction_nm=0.2, bristle_rad=4e-4, creep_rad_s=1.0
    )
    i, _, y = respond(brake, linear, still(0.0, 1.5), CONTROL)
    torque = 1.5 * 2 * MAGNET * i[-1, 1]
    assert 0.01 * (torque - 0.2 * 1.3) <= y[TWIST] <= 0.01 * torque
    _, _, back = respond(brake, linear, np.concatenate([still(0.0, 1.5), still(0.0, 0.0)]), CONTROL)
    assert 2e-4 < back[TWIST] < 0.01 * 0.2 * 1.3


def test_a_hall_sensor_of_second_order_lags_a_ramp_by_its_damping() -> None:
    w, z, h = 3e5, 0.7, 2.5e-5
    step = hall_transition(w, z, h)
    x = v = 0.0
    for k in range(200):
        x, v = (
            step[0] @ [x, v, k * h * 1e3, (k + 1) * h * 1e3],
            step[1] @ [x, v, k * h * 1e3, (k + 1) * h * 1e3],
        )
    assert 200 * h * 1e3 - x == pytest.approx(1e3 * 2 * z / w, rel=1e-6)


def test_shunts_of_equal_gain_read_what_two_sensors_read(linear: Iron) -> None:
    wave = still(5.0, -3.0, 300)
    two, _, _ = respond(PLAIN, linear, wave)
    three, _, _ = respond(PLAIN._replace(shunts=1.0), linear, wave)
    unequal, _, _ = respond(PLAIN._replace(shunts=1.0, gain_c=1.02), linear, wave)
    assert three == pytest.approx(two, abs=1e-12)
    assert np.abs(unequal - two).max() > 1e-3


def test_the_library_s_effect_undoes_reconstructed_shunts(linear: Iron) -> None:
    t = TS * np.arange(400)
    wave = 20.0 * np.stack([np.cos(40.0 * t), np.sin(40.0 * t)], axis=1)
    wave += np.where(np.arange(400) % 20 < 10, 60.0, -60.0)[:, None] * [[0.8, 0.6]]
    true, v, _ = respond(PLAIN, linear, wave)
    plant = PLAIN._replace(shunts=1.0, gain_a=1.02, gain_b=0.99, gain_c=0.99)
    read, _, _ = respond(plant, linear, wave)
    rows = len(t)
    signals = Signals(
        start_s=0.0, sampling_frequency_hz=1.0 / TS, pwm_frequency_hz=1.0 / TS, i_ab=read, v_ab=v,
        v_dc=np.full(rows, BUS_V), theta_rad=np.zeros(rows), resistance_ohm=np.full(rows, R), i_m_ab=read,
        heat_j=np.zeros(rows),
    )  # fmt: skip
    effect = ShuntReconstruction()
    undone = effect.correct(signals, effect.Parameters(gain_a_minus_b=0.03, gain_c_minus_ab=-0.015)).i_ab
    assert np.abs(read - true).max() > 0.01
    # The first reading's command is not in the recording.
    assert undone is not None
    assert undone[1:] == pytest.approx(true[1:], abs=1e-12)


def test_short_pulses_are_left_out_at_the_rails_only(linear: Iron) -> None:
    low, _, _ = respond(PLAIN._replace(shortest=0.02), linear, still(20.0, 0.0, 50))
    plain, _, _ = respond(PLAIN, linear, still(20.0, 0.0, 50))
    assert low == pytest.approx(plain)
    high, _, _ = respond(PLAIN._replace(shortest=0.02), linear, still(0.97 * BUS_V * 2 / 3, 0.0, 3))
    full, _, _ = respond(PLAIN, linear, still(0.97 * BUS_V * 2 / 3, 0.0, 3))
    assert np.abs(high - full).max() > 1e-3


def test_a_shorted_turn_takes_energy_from_one_phase(linear: Iron) -> None:
    t = TS * np.arange(3000)
    wave = 20.0 * np.cos(2 * np.pi * 100.0 * t)[:, None] * [[1.0, 1.0]]
    plain, _, _ = respond(PLAIN, linear, wave)
    i, _, _ = respond(PLAIN._replace(turn_siemens=2e-3, turn_s=2e-4), linear, wave)
    assert np.abs(i[:, 0] - plain[:, 0]).max() > 5e-3
    assert i[:, 1] == pytest.approx(plain[:, 1], abs=1e-9)


def test_finer_steps_converge(linear: Iron) -> None:
    square = np.where(np.arange(500) % 20 < 10, 40.0, -40.0)[:, None] * [[0.8, 0.6]] + [[6.0, 3.0]]
    plant = PLAIN._replace(
        eddy_siemens=2e-3, held_a=0.03, held_per_wb=1.5, magnet_wb=MAGNET, dead_v=3.0, dead_a=0.1, knee_v=1.0,
        knee_a=0.05, knee_per_asinh=0.2, spring_per_nm=0.005, resonance=2000.0, friction_nm=0.1, bristle_rad=1e-4,
        line_ohm=5.0, link_ohm=2.0, slot_k_per_w=0.3, room_k_per_w=0.5,
    )  # fmt: skip
    charge = charge_table(0.6, 0.1)
    coarse, fine, finest = (
        respond(plant._replace(substeps=n), linear, square, relays=LOOPS, charge=charge)[0] for n in (4, 8, 16)
    )
    # Below the sensors' noise with the steps in use.
    assert np.abs(coarse - finest).max() < 2e-3
    assert np.abs(fine - finest).max() < 0.7 * np.abs(coarse - finest).max()


def test_what_is_absent_does_nothing(linear: Iron) -> None:
    plain, _, _ = respond(PLAIN, linear, still(8.0, 4.0, 200))
    assert replace(linear, grid=linear.grid.copy()).flux(1.0, 1.0) == pytest.approx([MAGNET + L_D, L_Q])
    explicit = PLAIN._replace(spring_per_nm=0.0, friction_nm=1.0, link_ohm=3.0, eddy_slow_s=1.0)
    assert np.array_equal(respond(explicit, linear, still(8.0, 4.0, 200))[0], plain)
