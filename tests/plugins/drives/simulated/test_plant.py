"""The plant's step loop against an independent integration, energy and the step size."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._derive import TruePlant, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._energy import current
from plugins.drives.simulated._program import tune
from plugins.drives.simulated._run import GIVEN, Piece, run
from plugins.drives.simulated.options import SimulatedOptions
from protocols import CurrentControl, InputError, Motor
from tests.plugins.drives.simulated.conftest import MOTORS, PM400, options_of

FS = 10_000.0
EFFECTS: dict[str, Any] = {
    "dead_time": {"voltage_v": 3.0, "threshold_a": 0.3},
    "device_drop": {"voltage_v": 1.0, "threshold_a": 0.2, "on_resistance_ohm": 0.1},
    "bus_sag": {"per_watt": 2e-5},
    "phase_resistance_imbalance": {"extra_a_ohm": 0.2, "extra_b_ohm": 0.05},
    "voltage_bias": {"bias_a_v": 0.2, "bias_b_v": -0.1},
    "skin_effect": {"extra_ohm": 1.0},
    "brake_compliance": {"rad_per_nm": 0.02, "lag_s": 2e-3},
    "slot_harmonics": {"relative": 0.03},
}


def plant_of(motor: Motor = PM400, effects: dict[str, Any] | None = None, **plant: Any) -> TruePlant:
    options = options_of(plant={"effects": effects or {}, "sensors": {"noise_a": 0.0, "quantum_a": 0.0}, **plant})
    nameplate = read_nameplate(motor)
    return derive(options, nameplate, bus_voltage(options, nameplate))


def simulate(plant: TruePlant, v_ab: np.ndarray, x: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Currents as sampled under given voltages, and the state in the end; the rotor locked at angle 0."""
    n = len(v_ab)
    state = np.zeros(layout.STATE_LENGTH) if x is None else x
    if x is None:
        state[layout.PSI_D], state[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    i, v, bus = np.zeros((n, 2), np.float32), np.ascontiguousarray(v_ab, np.float32), np.zeros(n, np.float32)
    control = tune(read_nameplate(PM400), CurrentControl(), 0.0, FS, max_v=1e9, trip_a=1e9, overload_s=None)
    noise = np.zeros((n, 2), np.float32)
    locked = plant.locked(None)
    piece, sums, none = Piece(GIVEN, n), np.zeros(2), np.empty((0, 3), np.float32)
    run(locked, *plant.magnetics, plant.sensors, control, piece, 0, n, state, sums, noise, i, v, bus, none, None)
    return np.asarray(i, np.float64), state


def square_wave(n: int, amplitude_v: float, base: tuple[float, float], period: int = 20) -> np.ndarray:
    wave = np.where(np.arange(n) % period < period // 2, amplitude_v, -amplitude_v)
    angle = 2 * math.pi * np.arange(n) / n
    return np.asarray(np.array(base) + wave[:, None] * np.column_stack((np.cos(angle), np.sin(angle))))


def reference(plant: TruePlant, v_ab: np.ndarray) -> np.ndarray:
    """(psi_d, psi_q) in the end, by scipy at tight tolerance, from the equations written out once more."""
    p, h = plant.parameters, 1.0 / FS
    clarke = np.array([[2.0, -1.0, -1.0], [0.0, math.sqrt(3.0), -math.sqrt(3.0)]]) / 3.0
    phases = np.array([[1.0, 0.0], [-0.5, math.sqrt(0.75)], [-0.5, -math.sqrt(0.75)]])
    extra = np.array([0.2, 0.05, 0.0]) + 0.1

    def soft(i_abc: np.ndarray, threshold: float) -> np.ndarray:
        x = np.clip(i_abc / threshold, -1.0, 1.0)
        return 1.5 * x - 0.5 * x**3

    def rhs(_: float, y: np.ndarray, v: np.ndarray) -> np.ndarray:
        psi, theta, skin = y[:2], y[2], y[3:5]
        i_dq = np.array(current(*plant.magnetics, psi[0], psi[1]))
        z = psi - [plant.magnetics.energy.psi_m, 0.0]
        angle = 6 * theta + math.pi / 4
        c, s = p.slot_per_h * math.cos(angle), p.slot_per_h * math.sin(angle)
        i_dq = i_dq + np.array([[c, s], [s, -c]]) @ z
        coenergy_slope = 0.5 * z @ (6 * np.array([[-s, c], [c, s]])) @ z
        torque = 1.5 * 2 * (psi[0] * i_dq[1] - psi[1] * i_dq[0] - coenergy_slope)
        turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
        i_ab = turn @ i_dq
        i_abc = phases @ i_ab
        lost = clarke @ (3.0 * soft(i_abc, 0.3) + 1.0 * soft(i_abc, 0.2) + extra * i_abc)
        bias = clarke @ np.array([0.2, -0.1, -0.1])
        u = v * (1 - 2e-5 * 1.5 * (v @ i_ab)) - lost - bias - 4.25 * i_ab - 1.0 * (i_ab - skin)
        speed = (0.02 * torque - theta) / 2e-3
        dpsi = turn.T @ u - speed * np.array([-psi[1], psi[0]])
        return np.array([*dpsi, speed, *(2 * math.pi * 60.0 * (i_ab - skin))])

    y = np.array([plant.magnetics.energy.psi_m, 0.0, 0.0, 0.0, 0.0])
    for v in v_ab.astype(np.float32).astype(np.float64):
        y = solve_ivp(rhs, (0.0, h), y, args=(v,), rtol=1e-10, atol=1e-13, method="DOP853").y[:, -1]
    return y[:2]


def test_the_loop_converges_to_an_independent_integration() -> None:
    v = square_wave(300, 40.0, (6.0, 9.0))
    exact = reference(plant_of(effects=EFFECTS), v)
    errors = []
    for substeps in (2, 4, 8):
        _, state = simulate(plant_of(effects=EFFECTS, substeps=substeps), v)
        errors.append(float(np.abs(state[[layout.PSI_D, layout.PSI_Q]] - exact).max()))
    assert errors[-1] < 3e-9  # of 0.3 Wb
    assert errors[2] < errors[1] / 4 < errors[0] / 16
    _, usual = simulate(plant_of(effects=EFFECTS), v)
    assert np.abs(usual[[layout.PSI_D, layout.PSI_Q]] - exact).max() < 1e-6


@pytest.mark.parametrize(
    "effects",
    [
        {"hysteresis": {"half_width_a": 0.05}},
        {"eddy_currents": {"core_loss_ohm": 1000.0}, "dead_time": {"voltage_v": 8.0}},
        {"voltage_delay": {"delay_s": 3e-5}, "current_filter": {"time_constant_s": 2e-5}},
        {"winding_heating": {"rise_per_watt": 0.05, "time_constant_s": 0.05}},
    ],
    ids=lambda e: "+".join(e),
)
def test_the_usual_step_is_fine_enough(effects: dict[str, Any]) -> None:
    v = square_wave(400, 40.0, (4.0, 8.0))
    usual, _ = simulate(plant_of(effects=effects), v)
    fine, _ = simulate(plant_of(effects=effects, substeps=32), v)
    assert np.abs(usual - fine).max() < 5e-4  # of 2 A; half a step of the usual sensor


@pytest.mark.parametrize("motor", MOTORS)
def test_what_goes_in_is_heat_or_field(motor: Motor) -> None:
    """Electric work = copper loss + change of H, at a locked rotor without iron losses."""
    plant = plant_of(motor, substeps=4)
    assert motor.rated_current_a is not None
    volts = (motor.stator_resistance_ohm or 0.0) * motor.rated_current_a
    v = np.tile([volts, 0.7 * volts], (200, 1)).astype(np.float32).astype(np.float64)
    times = 16
    x = np.zeros(layout.STATE_LENGTH)
    x[layout.PSI_D], x[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    slow = plant.parameters._replace(sample_s=1.0 / FS / times)
    i, x = simulate(TruePlant(**{**vars(plant), "parameters": slow}), np.repeat(v, times, axis=0), x)
    step = 1.0 / FS / times
    work = float((np.repeat(v, times, axis=0) * i).sum() * step)
    heat = float((motor.stator_resistance_ohm or 0.0) * (i**2).sum() * step)
    path = np.linspace([plant.magnetics.energy.psi_m, 0.0], x[:2], 2001)
    along = np.array([current(*plant.magnetics, d, q) for d, q in 0.5 * (path[1:] + path[:-1])])
    field = float((along * np.diff(path, axis=0)).sum())
    assert work == pytest.approx(heat + field, rel=2e-3)


def test_a_closed_flux_loop_costs_energy_with_hysteresis_only() -> None:
    def loss(effects: dict[str, Any]) -> float:
        plant = plant_of(effects=effects, resistance_ohm=1e-9)
        n = 2000
        v = 20.0 * np.column_stack((np.zeros(n), np.cos(2 * math.pi * np.arange(n) / 500)))
        i, _ = simulate(plant, v)
        middle = 0.5 * (i[501:1501] + i[500:1500])
        return float((v[500:1500] * middle).sum() / FS)

    assert loss({"hysteresis": {"half_width_a": 0.05}}) > 1e-3
    assert abs(loss({})) < 1e-5


def test_more_steps_than_end_are_refused() -> None:
    with pytest.raises(ValidationError, match="10000"):
        SimulatedOptions.model_validate({"plant": {"substeps": 1_000_000_000}})


def test_a_plant_too_stiff_to_simulate_is_refused() -> None:
    with pytest.raises(InputError, match="needs over 10000 integration steps a sample"):
        plant_of(effects={"dead_time": {"voltage_v": 1e12}})
