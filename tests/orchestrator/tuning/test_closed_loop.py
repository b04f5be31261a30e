from __future__ import annotations

import ctypes
import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.tuning.current_control import open_loop_at, phase_margin, phase_margin_at
from orchestrator.tuning.limits import VOLTAGE_RESERVE, DriveLimits
from tests.orchestrator.tuning.closed_loop import Loop, Plant
from tests.orchestrator.tuning.functions import HostFunctions
from tests.orchestrator.tuning.tables import LIMITS, Tables, exact_compensation, tables_of
from tests.support.cases import few

PLANT = Plant()
INVERTER = Plant(dead_time=2e-6, drop_v=1.0, drop_ohm=0.02)
LARGEST_TORQUE_NM = 10.0
SPEEDS_RAD_S = (-2500.0, -800.0, 60.0, 1500.0, 2000.0, 2500.0, 3000.0)
TORQUES_NM = (-9.0, -5.0, -1.0, 1.0, 3.0, 5.0, 7.0, 9.0)
CURRENTS_A = ([0.0, 0.0], [-5.0, 8.0], [-12.5, 15.5])
RELATIVE_STD = 0.08
"""Of the inductances, for bands."""
SETTLED = 700
"""Periods after which nothing moves any more."""
UP_TO_SPEED = 500
"""Periods in which the speed rises to that of a test."""
MAX_OVERSHOOT = 0.05
MAX_EXCESS_CURRENT = 1.01
"""Over the limit, of full reversals: the ends of the path in the plane of flux lie on it."""
INJECTED_V = 1.0
BINS = 1000
"""Periods of the window of a frequency response; the injected frequency takes a whole number of them."""

Make = Callable[[Tables], Loop]
Complex = NDArray[np.complex128]


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    def made_of(tables: Tables) -> Loop:
        folder: Path = tmp_path_factory.mktemp("loop")
        return Loop(tables.files(), folder)

    return made_of


@pytest.fixture(scope="module")
def tables() -> Tables:
    return tables_of(PLANT)


@pytest.fixture(scope="module")
def loop(tables: Tables, make: Make) -> Loop:
    return make(tables)


@pytest.fixture(scope="module")
def uncertain() -> Tables:
    """Tuned for a map with a band."""
    return tables_of(PLANT, std=RELATIVE_STD)


def reached_torque_nm(loop: Loop, speed: float, v_dc: float = PLANT.v_dc) -> float:
    return HostFunctions(loop.library).number("torque_limit_nm", speed, v_dc, math.nan)


def ramp(speed: float, torque_nm: Array) -> Array:
    """Commands: up to speed without torque, then torques, one a period."""
    up = UP_TO_SPEED
    rows = np.zeros((up + len(torque_nm), 6))
    rows[:up, 1], rows[up:, 1], rows[up:, 0] = np.linspace(0.0, speed, up), speed, torque_nm
    rows[:, 4], rows[:, 5] = PLANT.v_dc, 1.0
    return rows


def settled(loop: Loop, plant: Plant, torque: float, speed: float) -> dict[str, Array]:
    """The last hundred periods."""
    run = loop.run(plant, ramp(speed, np.full(SETTLED, torque)))
    return {name: values[-100:] for name, values in run.items()}


def reachable(loop: Loop) -> list[tuple[float, float]]:
    return [(w, t) for w in SPEEDS_RAD_S for t in TORQUES_NM if abs(t) <= reached_torque_nm(loop, w)]


def test_plant_s_flux_is_the_same_in_c_and_here_and_reciprocal(loop: Loop) -> None:
    parameters = np.array(dataclasses.astuple(PLANT))
    for i in np.random.default_rng(1).uniform(-20.0, 20.0, (50, 2)):
        psi, slopes = (ctypes.c_double * 2)(), (ctypes.c_double * 3)()
        d, q = (ctypes.c_double(x) for x in i)
        loop.library.plant_flux(ctypes.c_void_p(parameters.ctypes.data), d, q, psi, slopes)
        assert psi[:] == pytest.approx(PLANT.psi(i), rel=1e-12)
        columns = [(PLANT.psi(i + 1e-5 * e) - PLANT.psi(i - 1e-5 * e)) / 2e-5 for e in np.eye(2)]
        assert slopes[:] == pytest.approx([columns[0][0], columns[0][1], columns[1][1]], rel=1e-6, abs=1e-9)
        assert columns[0][1] == pytest.approx(columns[1][0], abs=1e-9)


def test_torque_is_the_one_commanded_over_torque_and_speed(loop: Loop, tables: Tables, make: Make) -> None:
    """rms of the error over the largest torque; beside it, references from one pair of inductances."""
    rated = np.array([-12.5, 15.5])
    chord = (PLANT.psi(rated) - [PLANT.psi_m, 0.0]) / rated
    constant = tables_of(PLANT, lambda i_dq: i_dq * chord + [PLANT.psi_m, 0.0])
    by_nameplate = make(dataclasses.replace(tables, references=constant.references))
    points = reachable(loop)
    assert len(points) > 40
    errors = {}
    for name, each, at in (("flux map", loop, points), ("constant L", by_nameplate, points[::3])):
        reached = np.array([settled(each, PLANT, t, w)["torque"].mean() for w, t in at])
        errors[name] = float(np.sqrt(np.mean((reached - [t for _, t in at]) ** 2))) / LARGEST_TORQUE_NM
        print(f"{name}: torque {100 * errors[name]:.3f} % rms")
    assert errors["flux map"] <= 0.005
    assert errors["constant L"] > 4.0 * errors["flux map"]


@pytest.mark.slow
def test_a_warm_winding_whose_temperature_is_known_costs_torque_and_keeps_the_voltage_s_reserve(
    tables: Tables, make: Make
) -> None:
    """In field weakening R_s takes from the voltage: references for a cold winding use up the reserve."""
    cold_ohm, winding_c, speed = 2.0, 140.0, 1500.0
    loop = make(tables_of(dataclasses.replace(PLANT, r_s=cold_ohm)))
    warm = dataclasses.replace(PLANT, r_s=cold_ohm * (1.0 + 0.00393 * (winding_c - 20.0)))
    length = {}
    for known_c in (20.0, winding_c):
        end = settled(loop, dataclasses.replace(warm, winding_c=known_c), 9.0, speed)
        length[known_c] = float(end["length_v"].mean()) / LIMITS.voltage_v
    print(f"voltage of a warm winding: {length[20.0]:.4f} of the largest, with its temperature {length[winding_c]:.4f}")
    assert length[20.0] > 1.0 - 0.4 * VOLTAGE_RESERVE
    assert length[winding_c] == pytest.approx(1.0 - VOLTAGE_RESERVE, abs=0.01)


def test_more_torque_than_there_is_gives_the_largest(loop: Loop) -> None:
    for speed in (800.0, 2500.0):
        end = settled(loop, PLANT, 50.0, speed)
        assert end["torque"].mean() == pytest.approx(reached_torque_nm(loop, speed), rel=0.005)
        assert (end["report"] == 1).all()


@few("speed", [0.0, 800.0, 1500.0, 2200.0, 3000.0, -2200.0], fast=3)
def test_steps_of_torque_stay_within_current_and_voltage(loop: Loop, speed: float) -> None:
    command = np.repeat([3.0, -3.0, 10.0, -10.0, 10.0, 0.0], 200)
    run = loop.run(PLANT, ramp(speed, command))
    assert np.hypot(run["i_d"], run["i_q"]).max() <= MAX_EXCESS_CURRENT * LIMITS.current_a
    assert run["length_v"].max() <= PLANT.v_dc / math.sqrt(3.0) * (1.0 + 1e-6)
    steady = np.array([run["torque"][k] for k in range(UP_TO_SPEED + 199, len(run["torque"]), 200)])
    most = reached_torque_nm(loop, speed)
    assert steady == pytest.approx(np.clip(command[199::200], -most, most), abs=0.005 * LARGEST_TORQUE_NM)


@pytest.mark.parametrize("speed", [0.0, 700.0, 1400.0])
def test_a_step_of_current_ends_without_error_and_hardly_overshoots(loop: Loop, tables: Tables, speed: float) -> None:
    """Steps for which the voltage suffices, from the flux at half the current."""
    before, after = np.array([-5.0, 7.0]), np.array([-6.0, 9.0])
    run = loop.currents(PLANT, np.repeat([before, after], 1000, axis=0), speed)
    i = np.stack([run["i_d"], run["i_q"]], axis=-1)[1000:]
    step = PLANT.psi(after) - PLANT.psi(before)
    along = (PLANT.psi(i) - PLANT.psi(before)) @ step / (step @ step)
    across = (PLANT.psi(i) - PLANT.psi(before)) @ [-step[1], step[0]] / (step @ step)
    print(f"{speed:.0f} rad/s: overshoot {100 * (along.max() - 1.0):.2f} %, across {100 * np.abs(across).max():.1f} %")
    assert (run["report"][1000:] == 0).all()
    assert i[-1] == pytest.approx(after, abs=1e-3)
    assert along.max() <= 1.0 + MAX_OVERSHOOT
    assert np.abs(across).max() <= 0.02
    reached = int(np.argmax(along > 1.0 - math.exp(-1.0)))
    expected = 1.0 / tables.control.bandwidth_rad_s + tables.control.delay_s
    assert reached * PLANT.period == pytest.approx(expected, abs=1.5 * PLANT.period)


def open_loop(loop: Loop, plant: Plant, i_dq: Array, speed: float, bins: Sequence[int]) -> tuple[Array, Complex]:
    """Frequencies [rad/s] and the loop's response to vectors turning forwards, and backwards (conjugate), shape (n, 2).

    A sine is added to the voltage on each axis in turn; what the controller answers beyond R_s i is the open loop times
    the sum of both.
    """
    count = 3 * BINS
    responses = []
    for cycles in bins:
        turn = 2.0 * math.pi * cycles / BINS
        window = np.exp(-1j * turn * np.arange(count))[-BINS:]
        answer, sent = np.zeros((2, 2), complex), np.zeros((2, 2), complex)
        for axis in (0, 1):
            injected = {"injected_v": INJECTED_V, "injected_rad_per_sample": turn, "injected_axis": float(axis)}
            run = loop.currents(dataclasses.replace(plant, **injected), np.tile(i_dq, (count, 1)), speed)
            for k, name in enumerate("dq"):
                v = run[f"v_{name}"] - plant.r_s * run[f"i_{name}"]
                answer[k, axis] = v[-BINS:] @ window
            sent[axis, axis] = run["injected"][-BINS:] @ window
        matrix = -answer @ np.linalg.inv(answer + sent)
        even, odd = 0.5 * (matrix[0, 0] + matrix[1, 1]), 0.5j * (matrix[1, 0] - matrix[0, 1])
        responses.append([even + odd, even - odd])
    return 2.0 * math.pi * np.array(bins) / BINS / plant.period, np.array(responses)


def margin_deg(frequency: Array, response: Complex) -> float:
    """Phase margin of a response at positive frequencies."""
    at = np.interp(0.0, -np.log(np.abs(response)), np.log(frequency))
    phase = float(np.degrees(np.interp(at, np.log(frequency), np.unwrap(np.angle(response)))))
    return phase % 360.0 - 180.0


@few("i_dq", CURRENTS_A)
def test_phase_margin_at_standstill_is_the_one_promised(loop: Loop, tables: Tables, i_dq: list[float]) -> None:
    frequency, response = open_loop(loop, PLANT, np.array(i_dq), 0.0, range(25, 60, 5))
    for column in response.T:
        found = margin_deg(frequency, column)
        print(f"{i_dq}: phase margin {found:.1f} degrees, promised {tables.control.phase_margin_deg:.1f}")
        assert found == pytest.approx(tables.control.phase_margin_deg, abs=2.0)


def softer(plant: Plant, d: float, q: float, cross: float) -> Plant:
    """With its inductances times factors."""
    inductances = {"l_d": d * plant.l_d, "l_q": q * plant.l_q, "l_leak": q * plant.l_leak, "cross": cross * plant.cross}
    return dataclasses.replace(plant, **inductances)


@pytest.mark.slow
def test_phase_margin_at_the_band_s_edge_is_the_one_promised(uncertain: Tables, make: Make) -> None:
    least = 1.0 - 1.96 * RELATIVE_STD
    plant = softer(PLANT, least, least, least)
    frequency, response = open_loop(make(uncertain), plant, np.zeros(2), 0.0, range(20, 60, 5))
    found = margin_deg(frequency, response[:, 0])
    control = uncertain.control
    expected = math.degrees(phase_margin(control.bandwidth_rad_s, control.delay_s, 1.0 / least))
    least_deg = control.least_phase_margin_deg
    print(f"edge of the band: {found:.1f} degrees, formula {expected:.1f}, promised {least_deg:.1f}")
    assert found == pytest.approx(expected, abs=2.0)
    assert found > least_deg - 2.0


@few("speed", [1400.0, 700.0, 0.0])
def test_phase_margin_at_speed_is_that_of_its_formula(loop: Loop, tables: Tables, speed: float) -> None:
    frequency, response = open_loop(loop, PLANT, np.array([-5.0, 8.0]), speed, range(15, 85, 10))
    least = []
    for sign, column in zip((1.0, -1.0), response.T, strict=True):
        formula = open_loop_at(tables.control, sign * frequency, speed)
        expected = margin_deg(frequency, formula if sign > 0.0 else np.conj(formula))
        found = margin_deg(frequency, column)
        print(f"{sign * speed:.0f} rad/s: {found:.1f} degrees, formula {expected:.1f}")
        assert found == pytest.approx(expected, abs=2.0)
        least.append(found)
    assert min(least) > 45.0
    assert math.degrees(phase_margin_at(tables.control, speed)) == pytest.approx(min(least), abs=2.0)


def compensated(tables: Tables, plant: Plant) -> Tables:
    """With the compensation of a plant of the same map."""
    return dataclasses.replace(tables, compensation=exact_compensation(plant))


def harmonics(run: dict[str, Array], period: int, turns: int) -> Array:
    """Amplitudes of the 1st, 5th and 7th harmonic of a phase current [A]."""
    spectrum = 2.0 * np.fft.rfft(run["phase_a"][-period * turns :]) / (period * turns)
    return np.abs(spectrum[[turns, 5 * turns, 7 * turns]])


@few("torque", [1.0, 8.0])
def test_compensation_removes_the_inverter_s_harmonics_at_two_per_cent_speed(
    tables: Tables, make: Make, torque: float
) -> None:
    loop, speed = make(compensated(tables, INVERTER)), 2.0 * math.pi * 10.0
    distortion = []
    for is_compensated in (0.0, 1.0):
        run = loop.torque(dataclasses.replace(INVERTER, is_compensated=is_compensated), torque, speed, 4000)
        first, fifth, seventh = harmonics(run, 1000, 2)
        distortion.append(math.hypot(fifth, seventh) / first)
    print(f"{torque:g} Nm: 5th and 7th {100 * distortion[0]:.2f} %, compensated {100 * distortion[1]:.3f} %")
    assert distortion[0] > 0.01
    assert distortion[1] < 0.2 * distortion[0]


def test_compensation_removes_errors_of_sensors_and_angle(tables: Tables, make: Make) -> None:
    sensors = {"gain_a": 1.03, "gain_b": 0.98, "offset_a": 0.2, "offset_b": -0.1, "noise_a": 0.05, "angle_error": 0.05}
    plant = dataclasses.replace(INVERTER, **sensors)
    loop, errors = make(compensated(tables, plant)), {}
    for is_compensated in (0.0, 1.0):
        run = loop.run(dataclasses.replace(plant, is_compensated=is_compensated), ramp(2000.0, np.full(3000, 5.0)))
        torque = run["torque"][-2000:]
        errors[is_compensated] = math.hypot(float(torque.mean()) - 5.0, float(torque.std()))
    assert errors[0.0] > 0.1
    assert errors[1.0] < 0.02


def least_loss(torque: float, speed: float) -> float:
    """Least |i|^2 [A^2] for a torque at a speed within the references' voltage, by a dense search.

    i_q is found by bisection at each i_d.
    """
    i_d = np.linspace(-LIMITS.current_a, 1.0, 20001)
    low, high = np.zeros_like(i_d), np.full_like(i_d, 1.5 * LIMITS.current_a)
    for _ in range(40):
        middle = 0.5 * (low + high)
        above = PLANT.torque_nm(np.stack([i_d, middle], axis=-1)) > abs(torque)
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    i = np.stack([i_d, math.copysign(1.0, torque) * high], axis=-1)
    v = PLANT.r_s * i + speed * PLANT.psi(i)[:, ::-1] * [-1.0, 1.0]
    allowed = np.linalg.norm(v, axis=-1) <= (1.0 - VOLTAGE_RESERVE) * LIMITS.voltage_v
    return float(np.where(allowed, (i**2).sum(axis=-1), np.inf).min())


@few("speed", [100.0, 1500.0, 2000.0, 2500.0, 3000.0], fast=2)
def test_copper_loss_is_the_least_for_the_torque(loop: Loop, speed: float) -> None:
    """Within the voltage that the references may use, motoring and braking."""
    for torque in (1.0, 3.0, 5.0, 8.0, -1.0, -5.0):
        if abs(torque) > reached_torque_nm(loop, speed):
            continue
        end = settled(loop, PLANT, torque, speed)
        i = np.array([end["i_d"].mean(), end["i_q"].mean()])
        least = least_loss(float(PLANT.torque_nm(i)), speed)
        excess = float(i @ i) / least - 1.0
        print(f"{speed:.0f} rad/s, {torque:g} Nm: {100 * excess:.4f} % above the least loss")
        assert excess <= 0.001


def test_it_follows_an_accelerating_rotor_through_field_weakening_and_back(loop: Loop) -> None:
    plant = dataclasses.replace(PLANT, inertia=2e-3, load_nm=1.0)
    rows = np.zeros((4000, 6))
    rows[:, 0] = np.repeat([8.0, -5.0], 2000)
    rows[:, 4], rows[:, 5] = PLANT.v_dc, 1.0
    run = loop.run(plant, rows)
    assert run["omega"].max() > 2500.0
    assert run["omega"][-1] < 1500.0
    assert np.hypot(run["i_d"], run["i_q"]).max() <= MAX_EXCESS_CURRENT * LIMITS.current_a
    most = np.array([reached_torque_nm(loop, w) for w in run["omega"]])
    error = run["torque"] - np.clip(rows[:, 0], -most, most)
    assert np.abs(error[60:2000]).max() < 0.01 * LARGEST_TORQUE_NM
    assert np.abs(error[2060:]).max() < 0.01 * LARGEST_TORQUE_NM


def test_a_bus_that_sags_in_field_weakening_costs_torque_and_not_control(loop: Loop) -> None:
    rows = ramp(2000.0, np.full(1500, 8.0))
    rows[UP_TO_SPEED + 500 : UP_TO_SPEED + 1000, 4] = 0.75 * PLANT.v_dc
    run = loop.run(PLANT, rows)
    assert np.hypot(run["i_d"], run["i_q"]).max() <= MAX_EXCESS_CURRENT * LIMITS.current_a
    assert run["torque"][UP_TO_SPEED + 990] < 7.5
    assert run["torque"][[UP_TO_SPEED + 490, -1]] == pytest.approx(8.0, abs=0.02)


def machines_of_the_band(count: int) -> list[Plant]:
    factors = np.random.default_rng(7).uniform(-1.0, 1.0, (count, 3))
    return [softer(PLANT, *(1.0 + 1.96 * RELATIVE_STD * f)) for f in factors]


def require_stable(loop: Loop, plants: list[Plant]) -> None:
    """Every machine settles at three currents, every other one at speed, and passes them by a tenth at most."""
    hold = 250
    command = np.repeat([[-2.0, 1.0], [-12.0, 14.0], [-3.0, -5.0]], hold, axis=0)
    for k, plant in enumerate(plants):
        run = loop.currents(plant, command, 1200.0 * (k % 2))
        i = np.stack([run["i_d"], run["i_q"]], axis=-1)
        assert np.abs(i[hold - 1 :: hold] - command[hold - 1 :: hold]).max() < 0.05, plant
        assert np.hypot(*i.T).max() < 1.1 * math.hypot(12.0, 14.0), plant


def test_machines_within_the_band_are_stable(uncertain: Tables, make: Make) -> None:
    require_stable(make(uncertain), machines_of_the_band(20))


@pytest.mark.slow
def test_a_thousand_machines_within_the_band_are_stable(uncertain: Tables, make: Make) -> None:
    require_stable(make(uncertain), machines_of_the_band(1000))


OTHER_MACHINES = {
    "small surface magnets": (
        Plant(psi_m=5e-3, l_d=1e-4, i_d=60.0, l_q=1e-4, i_q=60.0, l_leak=0.0, cross=0.0, r_s=0.5, pole_pairs=7.0,
              v_dc=24.0, period=5e-5),
        DriveLimits(current_a=10.0, bus_v=24.0, speed_rad_s=1500.0, sampling_hz=2e4, pwm_hz=2e4),
    ),
    "synchronous reluctance": (
        Plant(psi_m=0.0, l_d=12e-3, i_d=8.0, l_q=3e-3, i_q=40.0, l_leak=0.0, cross=2e-5, r_s=0.3, pole_pairs=2.0,
              v_dc=560.0, period=1.25e-4),
        DriveLimits(current_a=25.0, bus_v=560.0, speed_rad_s=1500.0, sampling_hz=8e3, pwm_hz=8e3),
    ),
    "traction": (
        Plant(psi_m=0.11, l_d=2e-4, i_d=600.0, l_q=6e-4, i_q=250.0, l_leak=5e-5, cross=1e-8, i_x=300.0, i_y=400.0,
              r_s=8e-3, pole_pairs=5.0, v_dc=650.0, period=1e-4),
        DriveLimits(current_a=400.0, bus_v=650.0, speed_rad_s=5000.0, sampling_hz=1e4, pwm_hz=1e4),
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHER_MACHINES)
def test_other_machines_give_their_torque_at_every_speed(make: Make, name: str) -> None:
    plant, limits = OTHER_MACHINES[name]
    tables = tables_of(plant, limits=limits, reach_a=1.25 * limits.current_a)
    loop, largest = make(tables), float(tables.references.torque_limit_nm[-1])
    command = np.repeat([0.5, -0.5, 1.0, -1.0], 500) * largest
    for share in (0.0, 0.3, 0.7, 1.0):
        rows = ramp(share * limits.speed_rad_s, command)
        rows[:, 4] = plant.v_dc
        run = loop.run(plant, rows)
        most = reached_torque_nm(loop, share * limits.speed_rad_s, plant.v_dc)
        steady = run["torque"][UP_TO_SPEED + 499 :: 500]
        assert steady == pytest.approx(np.clip(command[499::500], -most, most), abs=0.002 * largest)
        assert np.hypot(run["i_d"], run["i_q"]).max() <= 1.05 * limits.current_a
