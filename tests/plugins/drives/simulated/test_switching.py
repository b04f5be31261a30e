"""The switched inverter against circuits, charges and a simulation of its gates in steps of 20 ns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import _derive_switching
from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._bridge import NO_EDGE_S, edge_delay, edge_time
from plugins.drives.simulated._derive import TruePlant, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._energy import current
from plugins.drives.simulated._program import tune
from plugins.drives.simulated._run import GIVEN, Piece, run
from plugins.drives.simulated._switching import duties
from protocols import CurrentControl, Hold, Injection, Motor
from tests.plugins.drives.simulated.conftest import MOTORS, PM400, SERVO, Bench, options_of, rows

FS, BUS_V, R = 10_000.0, 540.0, 4.25
QUIET = {"noise_a": 0.0, "quantum_a": 0.0}
LINEAR: dict[str, Any] = {"kind": "polynomial"}
"""Constant inductances: those of the nameplate."""


def plant_of(motor: Motor = PM400, options: dict[str, Any] | None = None, **plant: Any) -> TruePlant:
    made = options_of(
        dc_bus_voltage_v=BUS_V if motor is PM400 else None,
        **(options or {}),
        plant={"inverter": "switched", "sensors": QUIET, **plant},
    )
    nameplate = read_nameplate(motor)
    return derive(made, nameplate, bus_voltage(made, nameplate))


def respond(plant: TruePlant, v_ab: np.ndarray, motor: Motor = PM400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Currents as sampled under given voltages, the bus as logged, and the state in the end; the rotor locked at 0."""
    n = len(v_ab)
    x = np.zeros(layout.STATE_LENGTH)
    x[layout.PSI_D], x[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    x[layout.SUPPLY] = x[layout.BUS] = plant.parameters.dc_bus_v
    x[layout.DUE : layout.DUE + 3] = NO_EDGE_S
    i, v, bus = np.zeros((n, 2), np.float32), np.ascontiguousarray(v_ab, np.float32), np.zeros(n, np.float32)
    control = tune(read_nameplate(motor), CurrentControl(), 0.0, FS, max_v=1e9, trip_a=1e9, overload_s=None)
    noise, piece, phases = np.zeros((n, 6), np.float32), Piece(GIVEN, n), np.zeros((n, 3), np.float32)
    run(
        plant.locked(None), *plant.magnetics, plant.sensors, control, piece, 0, n, x, np.zeros(2), noise, i, v, bus,
        phases, plant.bench,
    )  # fmt: skip
    return np.asarray(i, np.float64), np.asarray(bus, np.float64), x


def square_wave(n: int, amplitude_v: float, base: tuple[float, float], period: int = 20) -> np.ndarray:
    wave = np.where(np.arange(n) % period < period // 2, amplitude_v, -amplitude_v)
    angle = 2 * math.pi * np.arange(n) / n
    return np.asarray(np.array(base) + wave[:, None] * np.column_stack((np.cos(angle), np.sin(angle))))


def still(v_alpha: float, v_beta: float, n: int = 4000) -> np.ndarray:
    return np.tile([v_alpha, v_beta], (n, 1)).astype(float)


# Against the averaged inverter


@pytest.mark.parametrize("motor", MOTORS)
def test_without_imperfections_it_is_the_averaged_inverter(bench: Bench, motor: Motor) -> None:
    assert motor.rated_current_a is not None
    d, q = 0.3 * motor.rated_current_a, 0.6 * motor.rated_current_a
    volts = 0.3 * 2 * math.pi * 500.0 * (motor.d_inductance_h or 0.0) * motor.rated_current_a
    excitation = Injection(
        target_d_a=d, target_q_a=q, settle_s=0.3, duration_s=0.2, amplitude_v=volts, frequency_hz=500.0, rotation_hz=5.0
    )
    averaged, _ = rows(bench(motor=motor), excitation)
    switched, _ = rows(bench(motor=motor, plant={"inverter": "switched"}), excitation)
    # The ripple within a period sees an inductance that is taken at its start, and the resistance damps it.
    assert motor.d_inductance_h is not None
    assert motor.stator_resistance_ohm is not None
    damped = motor.stator_resistance_ohm * 1e-4 / motor.d_inductance_h
    assert np.abs(averaged - switched).max() < (2e-4 + damped**2 / 24.0) * motor.rated_current_a


def test_finer_parts_of_a_period_change_little(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = _derive_switching.MAX_STEP_DECAY
    excitation = Injection(
        target_d_a=2.0,
        target_q_a=4.0,
        settle_s=0.1,
        duration_s=0.05,
        amplitude_v=1.0,
        frequency_hz=500.0,
        rotation_hz=20.0,
    )
    currents = []
    for finest in (1.0, usual, 0.25 * usual):
        monkeypatch.setattr(_derive_switching, "MAX_STEP_DECAY", finest)
        currents.append(rows(bench(motor=SERVO, plant={"inverter": "switched"}), excitation)[0])
    halves, parts, fine = currents
    assert np.abs(halves - fine).max() > 1e-4
    assert np.abs(parts - fine).max() < 0.1 * np.abs(halves - fine).max()


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_at_each_pwm_frequency_the_mean_voltage_is_the_commanded_one(bench: Bench, ratio: float) -> None:
    drive = bench(plant={"inverter": "switched"})
    hold = Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.6, duration_s=0.1, pwm_frequency_hz=ratio * FS)
    i, v = rows(drive, hold)
    assert i.mean(axis=0) == pytest.approx([1.0, 0.5], rel=1e-4)
    assert v.mean(axis=0) == pytest.approx([R, 0.5 * R], rel=1e-4)


# Edges


def test_an_edge_that_the_current_holds_back_waits_for_the_dead_time() -> None:
    assert edge_delay(True, 1e-6, 1e-7, 1.0, 2.0) == 1e-6
    assert edge_delay(False, 1e-6, 1e-7, 1.0, -2.0) == 1e-6


@pytest.mark.parametrize("i", [0.02, 0.08, 0.1, 0.2, 3.0])
def test_an_edge_that_the_current_makes_has_the_volt_seconds_of_its_ramp(i: float) -> None:
    dead, c, v = 1e-6, 1e-10, BUS_V
    t = (np.arange(100_000) + 0.5) * dead / 100_000
    node = np.minimum(i * t / (2 * c), v)  # and the switch pulls it up at the end of the dead time
    lost = float((v - node).sum() * dead / 100_000)
    assert edge_delay(True, dead, 2 * c * v, 1.0, -i) == pytest.approx(lost / v, rel=1e-4)
    assert edge_delay(False, dead, 2 * c * v, 1.0, i) == edge_delay(True, dead, 2 * c * v, 1.0, -i)


@pytest.mark.parametrize("grading", [0.0, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("i", [0.02, 0.08, 0.2])
def test_a_swing_into_junctions_has_the_volt_seconds_of_its_charge(i: float, grading: float) -> None:
    """The node integrated in small steps of voltage, each taking the charge of both capacitances there."""
    dead, c, v = 1e-6, 1e-10, BUS_V
    s = np.linspace(0.0, 1.0, 200_001)
    u = s**6 / (s**6 + (1.0 - s) ** 6)  # fine at both rails, where the capacitances are without bounds
    middle = 0.5 * (u[1:] + u[:-1])
    flown = np.diff(u) * (middle**-grading + middle[::-1] ** -grading)
    t = np.append(0.0, np.cumsum(flown)) / flown.sum() * 2 * c * v / i
    node = np.interp((np.arange(200_000) + 0.5) * dead / 200_000, t, u)
    lost = float((1.0 - node).mean() * dead)
    assert edge_delay(True, dead, 2 * c * v, 1.0 - grading, -i) == pytest.approx(lost, rel=1e-3)


def test_junctions_keep_more_of_the_dead_time_at_small_currents() -> None:
    """The node hardly leaves its rail; a whole swing is no later than an even one."""
    even, graded = (edge_delay(True, 1e-6, 1e-7, power, -0.03) for power in (1.0, 0.5))
    assert 1e-6 > graded > 1.05 * even
    assert edge_delay(True, 1e-6, 1e-7, 0.5, -0.3) == edge_delay(True, 1e-6, 1e-7, 1.0, -0.3)


@pytest.mark.parametrize(("ratio", "i_alpha"), [(1.0, 2.0), (1.0, 0.6), (2.0, 0.6), (0.5, 0.6)])
def test_dead_time_loses_what_charge_and_frequency_say(ratio: float, i_alpha: float) -> None:
    """e = f V (t_d - C V / |i|) in each phase, well above 2 C V / t_d."""
    dead, c = 1e-6, 60e-12
    plant = plant_of(
        magnetics=LINEAR, switching={"dead_time_s": dead, "output_capacitance_f": c},
        options={"pwm_frequency_hz": ratio * FS},
    )  # fmt: skip

    def lost(i: float) -> float:
        return ratio * FS * BUS_V * (dead - c * BUS_V / i)

    expected = (2 * lost(i_alpha) + 2 * lost(0.5 * i_alpha)) / 3  # a carries i, b and c half of it back
    i, _, _ = respond(plant, still(R * i_alpha + expected, 0.0))
    v = R * float(i[-1, 0]) + (2 * lost(float(i[-1, 0])) + 2 * lost(0.5 * float(i[-1, 0]))) / 3
    assert v == pytest.approx(R * i_alpha + expected, rel=2e-3)
    assert i[-1, 1] == pytest.approx(0.0, abs=1e-4)


def test_near_zero_current_the_output_capacitance_is_a_resistance() -> None:
    """e = i f t_d^2 / (4 C) where both edges' swings are cut short."""
    dead, c = 1e-6, 200e-12
    plant = plant_of(magnetics=LINEAR, switching={"dead_time_s": dead, "output_capacitance_f": c})
    i, _, _ = respond(plant, still(0.3, 0.0))
    extra = FS * dead**2 / (4 * c)
    assert float(i[-1, 0]) == pytest.approx(0.3 / (R + extra), rel=5e-3)
    assert 0.5 * extra > R  # else nothing was seen


def test_one_leg_may_have_a_dead_time_of_its_own() -> None:
    even = plant_of(magnetics=LINEAR, switching={"dead_time_s": 5e-7, "output_capacitance_f": 0.0})
    odd = plant_of(magnetics=LINEAR, switching={"dead_time_s": [5e-7, 9e-7, 5e-7], "output_capacitance_f": 0.0})
    i, _, _ = respond(even, still(10.0, 20.0))
    j, _, _ = respond(odd, still(10.0, 20.0))
    # Leg b carries current towards the motor: its mean voltage is less by 0.4 us f V.
    lost = 4e-7 * FS * BUS_V
    assert R * (i[-1] - j[-1]) == pytest.approx([-lost / 3, lost / math.sqrt(3)], rel=4e-3)


def test_drops_are_those_of_the_device_that_conducts() -> None:
    """At half the bus each way, switch and diode conduct half of the time each."""
    plant = plant_of(
        magnetics=LINEAR,
        switching={"switch_drop_v": 1.0, "switch_ohm": 0.1, "diode_drop_v": 2.0, "diode_ohm": 0.3, "drop_knee_a": 1e-3},
    )
    i, _, _ = respond(plant, still(12.0, 0.0))
    a = float(i[-1, 0])
    share = 0.5 + 0.5 * 12.0 * 1.5 / BUS_V  # of leg a, which is high for longer
    in_a = share * (1.0 + 0.1 * a) + (1 - share) * (2.0 + 0.3 * a)
    in_b = share * (1.0 + 0.05 * a) + (1 - share) * (2.0 + 0.15 * a)  # low, and its current the other way
    assert 12.0 - R * a == pytest.approx((2 * in_a + 2 * in_b) / 3, rel=1e-3)


def test_warm_devices_drop_less_and_resist_more() -> None:
    hot = {"kelvin_per_watt": 10.0, "device_time_constant_s": 0.02}
    cold = respond(plant_of(switching={"switch_drop_v": 2.0}), still(20.0, 0.0))
    warm = respond(plant_of(switching={"switch_drop_v": 2.0, **hot}), still(20.0, 0.0))
    kelvin = 10.0 * 2.0 * 2.0 * float(warm[0][-1, 0])  # by 2 V at i, i/2 and i/2, while they are cold
    assert warm[2][layout.JUNCTION] == pytest.approx(kelvin / (1.0 + 0.002 * kelvin), rel=5e-3)
    assert float(warm[0][-1, 0]) > float(cold[0][-1, 0]) + 0.01
    resisting = respond(plant_of(switching={"switch_ohm": 0.5, "diode_ohm": 0.5, **hot}), still(20.0, 0.0))[0]
    assert float(resisting[-1, 0]) < 20.0 / (R + 0.5) * 0.99


def test_pulses_that_are_too_short_are_left_out() -> None:
    plant = plant_of(switching={"minimum_pulse_s": 8e-6})
    assert plant.bench is not None
    most = BUS_V / math.sqrt(3)
    full = duties(plant.bench.switching, 0.97 * most * math.cos(0.5), 0.97 * most * math.sin(0.5), BUS_V)
    assert max(full) == 1.0
    assert min(full) == 0.0
    usual = duties(plant.bench.switching, 0.5 * most, 0.0, BUS_V)
    assert sum(usual[k] for k in (0, 1)) == pytest.approx(1.0)
    assert min(usual) > 0.04


def test_the_timer_rounds_edges() -> None:
    plant = plant_of(switching={"timer_s": 1e-7})
    assert plant.bench is not None
    times = np.array([edge_time(plant.bench.switching.bridge, True, duty) for duty in np.linspace(0.3, 0.7, 50)])
    assert times * 1e7 == pytest.approx(np.round(times * 1e7), abs=1e-6)
    coarse = respond(plant, still(0.3, 0.0))[0]
    # 0.3 V move an edge by 21 ns: a timer of 100 ns makes nothing of it.
    assert coarse[-1, 0] == pytest.approx(0.0, abs=1e-6)


# Against gates simulated in steps of 20 ns


def gates(plant: TruePlant, v_ab: np.ndarray, step_s: float) -> np.ndarray:
    """Flux in the end: comparator, gate delays, node charge and diodes of each leg, step by step."""
    assert plant.bench is not None
    bridge = plant.bench.switching.bridge
    dead, c2 = bridge.dead_s[0], bridge.two_capacitances_f
    psi = np.array([plant.magnetics.energy.psi_m, 0.0])
    node = np.zeros(3)
    since = np.full(3, 1.0)  # time since the last command
    wanted = np.zeros(3, bool)
    clarke = np.array([[2.0, -1.0, -1.0], [0.0, math.sqrt(3.0), -math.sqrt(3.0)]]) / 3.0
    phases = np.array([[1.0, 0.0], [-0.5, math.sqrt(0.75)], [-0.5, -math.sqrt(0.75)]])
    count = round(1.0 / FS / step_s)
    for v in v_ab:
        duty = np.array(duties(plant.bench.switching, float(v[0]), float(v[1]), BUS_V))
        for n in range(count):
            phase = (n + 0.5) / count
            high = duty > (1.0 - 2.0 * phase if phase < 0.5 else 2.0 * phase - 1.0)
            since = np.where(high != wanted, 0.0, since + step_s)
            wanted = high
            i_ab = np.array(current(*plant.magnetics, psi[0], psi[1]))
            i = phases @ i_ab
            # In the dead time the phase current moves the node, up to the diodes; then the switch does.
            free = np.clip(node - i * step_s / c2, 0.0, BUS_V)
            node = np.where(since >= dead, np.where(wanted, BUS_V, 0.0), free)
            psi = psi + step_s * (clarke @ node - R * i_ab)
    return psi


def test_edges_are_those_of_gates_simulated_in_nanoseconds() -> None:
    switching = {"dead_time_s": 1e-6, "output_capacitance_f": 100e-12}
    plant = plant_of(magnetics=LINEAR, switching=switching)
    v = square_wave(6, 60.0, (3.0, 1.0), 4).astype(np.float32).astype(np.float64)
    exact = gates(plant, v, 2e-8)
    _, _, x = respond(plant, v)
    ideal = respond(plant_of(magnetics=LINEAR), v)[2]
    lost = np.abs(ideal[[0, 1]] - exact).max()
    assert np.abs(x[[0, 1]] - exact).max() < 0.02 * lost  # a step of the simulation is 2 % of the dead time


# Time


def first_answer(plant: TruePlant) -> np.ndarray:
    v = still(0.0, 0.0, 40)
    v[10:, 0] = 30.0
    i, _, _ = respond(plant, v)
    rise = np.diff(i[:, 0]) / (30.0 / FS / PM400.d_inductance_h) if PM400.d_inductance_h else i[:, 0]
    return np.asarray(rise[9:14])


@pytest.mark.parametrize(
    ("delay", "pwm_hz", "shares"),
    [
        (0.0, FS, [0, 1, 1, 1]),
        (1.0, FS, [0, 0, 1, 1]),
        (0.5, FS, [0, 0.5, 1, 1]),
        (0.5, 2 * FS, [0, 0.5, 1, 1]),
        (1.0, 0.5 * FS, [0, 0, 1, 1]),
    ],
)
def test_the_voltage_acts_as_late_as_the_drive_declares(delay: float, pwm_hz: float, shares: list[float]) -> None:
    plant = plant_of(magnetics=LINEAR, options={"voltage_delay_samples": delay, "pwm_frequency_hz": pwm_hz})
    assert first_answer(plant)[:4] == pytest.approx(shares, abs=0.03)


def test_an_averaged_reading_is_half_a_sample_old_and_declared_so(bench: Bench) -> None:
    plant = plant_of(magnetics=LINEAR, options={"current_sampling": "averaged"})
    assert first_answer(plant)[:4] == pytest.approx([0, 0.5, 1, 1], abs=0.03)
    drive = bench(armed=False, plant={"inverter": "switched"}, current_sampling="averaged", voltage_delay_samples=1.0)
    assert drive.connect().voltage_delay_samples == 1.5


def test_currents_sampled_where_the_carrier_turns_are_the_mean(bench: Bench) -> None:
    hold = Hold(current_d_a=1.0, current_q_a=1.5, settle_s=0.6, duration_s=0.05)
    for sampling in ("turning_point", "averaged"):
        drive = bench(plant={"inverter": "switched", "magnetics": LINEAR}, current_sampling=sampling)
        i, v = rows(drive, hold)
        assert v.mean(axis=0) / R == pytest.approx(i.mean(axis=0), rel=2e-5)


@pytest.mark.parametrize("offset_s", [-4e-6, 3e-6])
@pytest.mark.parametrize("delay", [0.0, 0.5])
def test_a_reading_off_centre_is_off_by_the_slope_of_the_zero_vector(offset_s: float, delay: float) -> None:
    v = still(40.0, 0.0, 3000)
    options = {"voltage_delay_samples": delay}
    centred, _, _ = respond(plant_of(magnetics=LINEAR, options=options), v)
    off, _, _ = respond(plant_of(magnetics=LINEAR, options=options, switching={"sampling_offset_s": offset_s}), v)
    slope = -R * centred[-1, 0] / (PM400.d_inductance_h or 1.0)
    assert off[-1, 0] - centred[-1, 0] == pytest.approx(slope * offset_s, rel=2e-2)


def test_a_late_bridge_is_a_reading_before_the_carrier_turns() -> None:
    v = square_wave(400, 40.0, (5.0, 2.0))
    late, _, _ = respond(plant_of(effects={"voltage_delay": {"delay_s": 4e-6}}), v)
    early, _, _ = respond(plant_of(switching={"sampling_offset_s": -4e-6}), v)
    assert np.array_equal(late, early)


def test_a_short_filter_lags_by_the_slope_of_the_zero_vector_alone() -> None:
    v = np.where(np.arange(800) % 20 < 10, 40.0, -40.0)[:, None] * [[1.0, 0.0]]
    plain, _, _ = respond(plant_of(magnetics=LINEAR), v)
    filtered, _, _ = respond(plant_of(magnetics=LINEAR, effects={"current_filter": {"time_constant_s": 2e-6}}), v)
    slope = -R * plain[1:, 0] / (PM400.d_inductance_h or 1.0)
    assert filtered[1:, 0] - plain[1:, 0] == pytest.approx(-2e-6 * slope, abs=0.02 * 2e-6 * np.abs(slope).max())


# The bus


def test_a_loaded_bus_sinks_and_is_logged_as_the_drive_is_reported() -> None:
    volts = still(25.0, 0.0)
    plain: dict[str, Any] = {"resistance_ohm": 2.0, "capacitance_f": 1e-3}
    i, bus, x = respond(plant_of(switching={"bus": plain}), volts)
    watts = 1.5 * R * float(i[-1, 0]) ** 2
    drawn = watts / float(x[layout.SUPPLY])
    assert x[layout.SUPPLY] == pytest.approx(BUS_V - 2.0 * drawn, rel=1e-5)
    assert bus[-1] == pytest.approx(x[layout.SUPPLY], rel=1e-6)
    assert R * i[-1, 0] == pytest.approx(25.0 * x[layout.SUPPLY] / BUS_V, rel=1e-4)
    _, wrong, _ = respond(plant_of(switching={"bus": {**plain, "gain": 1.02}}), volts)
    assert wrong[-1] == pytest.approx(1.02 * x[layout.SUPPLY], rel=1e-5)
    _, logged_v, _ = respond(plant_of(switching={"bus": {**plain, "logged": "nominal"}}), volts)
    assert (logged_v == BUS_V).all()
    right, _, _ = respond(plant_of(switching={"bus": {**plain, "compensated": True}}), volts)
    assert R * right[-1, 0] == pytest.approx(25.0, rel=1e-5)


def test_a_sagging_bus_is_a_source_with_a_resistance() -> None:
    per_watt = 1e-4
    i, _, _ = respond(plant_of(effects={"bus_sag": {"per_watt": per_watt}}), still(25.0, 0.0))
    a = float(i[-1, 0])
    assert R * a == pytest.approx(25.0 * (1.0 - per_watt * 1.5 * 25.0 * a), rel=1e-5)


def test_what_comes_from_the_bus_is_heat() -> None:
    plant = plant_of(
        switching={
            "dead_time_s": 1e-6, "output_capacitance_f": 0.0, "switch_drop_v": 1.0, "kelvin_per_watt": 1.0,
            "device_time_constant_s": 0.01, "bus": {"resistance_ohm": 1e-3},
        }
    )  # fmt: skip
    i, _, x = respond(plant, still(15.0, 6.0))
    drawn = (BUS_V - x[layout.SUPPLY]) / 1e-3
    copper = 1.5 * R * float((i[-1] ** 2).sum())
    assert BUS_V * drawn == pytest.approx(copper + x[layout.JUNCTION], rel=3e-3)
