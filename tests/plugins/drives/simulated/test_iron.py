"""Iron, shaft and heat of the simulated motor against circuits, springs and rooms whose answers are known."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._derive import TruePlant
from tests.plugins.drives.simulated import test_switching as switched
from tests.plugins.drives.simulated.conftest import PM400
from tests.plugins.drives.simulated.test_plant import FS, plant_of, simulate

LINEAR: dict[str, Any] = {"kind": "polynomial"}
L = (PM400.d_inductance_h or 1.0, PM400.q_inductance_h or 1.0)
NO_OHMS = 1e-9


def stepped(plant: TruePlant, axis: int, volts: float, n: int = 60) -> np.ndarray:
    """What flows along an axis beyond psi / L, a constant voltage on it from row 0 on."""
    v = np.zeros((n, 2))
    v[:, axis] = volts
    i, _ = simulate(plant, v)
    return np.asarray(i[:, axis] - volts * np.arange(n) / FS / L[axis])


def charged(volts: float, ohm: float, time_constant_s: float, n: int = 60) -> np.ndarray:
    return volts / ohm * -np.expm1(-np.arange(n) / FS / time_constant_s)


def test_a_core_s_current_comes_with_a_lag_and_differs_between_the_axes() -> None:
    eddy = {"core_loss_ohm": 800.0, "core_loss_q_ohm": 500.0, "time_constant_s": 4e-4}
    plant = plant_of(effects={"eddy_currents": eddy}, magnetics=LINEAR, resistance_ohm=NO_OHMS)
    assert stepped(plant, 0, 20.0) == pytest.approx(charged(20.0, 800.0, 4e-4), abs=1e-6)
    assert stepped(plant, 1, 20.0) == pytest.approx(charged(20.0, 500.0, 4e-4), abs=1e-6)


def test_a_core_loss_without_a_lag_stays_the_resistance_that_it_was() -> None:
    plant = plant_of(effects={"eddy_currents": {"core_loss_ohm": 800.0}}, magnetics=LINEAR, resistance_ohm=NO_OHMS)
    assert stepped(plant, 0, 20.0)[1:] == pytest.approx(20.0 / 800.0, abs=1e-6)


@pytest.mark.parametrize("axis", ["d", "q"])
def test_a_damper_is_closed_on_one_axis_alone(axis: str) -> None:
    plant = plant_of(
        damper={"axis": axis, "ohm": 50.0, "time_constant_s": 3e-3}, magnetics=LINEAR, resistance_ohm=NO_OHMS
    )
    on, other = (0, 1) if axis == "d" else (1, 0)
    assert stepped(plant, on, 5.0) == pytest.approx(charged(5.0, 50.0, 3e-3), abs=1e-6)
    assert stepped(plant, other, 5.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_behind_a_switched_bridge_core_and_damper_see_the_same_mean_voltage() -> None:
    eddy = {"core_loss_ohm": 800.0, "core_loss_q_ohm": 500.0, "time_constant_s": 1e-3}
    damper = {"axis": "q", "ohm": 50.0, "time_constant_s": 3e-3}
    shared: dict[str, Any] = {"damper": damper, "magnetics": LINEAR, "resistance_ohm": NO_OHMS}
    plant = switched.plant_of(effects={"eddy_currents": eddy}, **shared)
    v = np.tile([12.0, 6.0], (60, 1))
    i, _, _ = switched.respond(plant, v)
    extra = i - v * np.arange(60)[:, None] / FS / np.array(L)
    assert extra[:, 0] == pytest.approx(charged(12.0, 800.0, 1e-3), abs=2e-5)
    both = charged(6.0, 500.0, 1e-3) + charged(6.0, 50.0, 3e-3)
    assert extra[:, 1] == pytest.approx(both, abs=1e-4)


def test_on_a_switched_bridge_a_core_takes_its_loss_of_the_ripple_too() -> None:
    """Where the branch is as slow as the carrier, what it carries swings within the period."""
    eddy = {"core_loss_ohm": 800.0}
    plant = switched.plant_of(effects={"eddy_currents": eddy}, magnetics=LINEAR, resistance_ohm=NO_OHMS)
    v = np.tile([30.0, 0.0], (60, 1))
    i, _, _ = switched.respond(plant, v)
    extra = i[:, 0] - 30.0 * np.arange(60) / FS / L[0]
    # Two short pulses, a quarter and three quarters into the period, with the mean's area, through a lag of a period.
    swing = 0.5 * (math.exp(-0.25) + math.exp(-0.75)) / -math.expm1(-1.0)
    assert extra[-1] == pytest.approx(30.0 / 800.0 * swing, rel=1e-3)


def test_hysteresis_may_be_wider_along_one_axis() -> None:
    effects = {"hysteresis": {"half_width_a": 0.06, "q_over_d": 0.5}}
    plant = plant_of(effects=effects, magnetics=LINEAR, resistance_ohm=NO_OHMS)
    assert stepped(plant, 0, 30.0)[-1] == pytest.approx(0.06, rel=1e-3)
    assert stepped(plant, 1, 30.0)[-1] == pytest.approx(0.03, rel=1e-3)


def test_a_turn_of_the_flux_costs_energy_with_anisotropic_hysteresis() -> None:
    effects = {"hysteresis": {"half_width_a": 0.06, "q_over_d": 0.4}}
    plant = plant_of(effects=effects, magnetics=LINEAR, resistance_ohm=NO_OHMS)
    n = 2000
    turn = 2 * math.pi * np.arange(n) / 500
    v = 20.0 * np.column_stack((np.cos(turn), np.sin(turn)))
    i, _ = simulate(plant, v)
    middle = 0.5 * (i[501:1501] + i[500:1500])
    assert float((v[500:1500] * middle).sum() / FS) > 1e-3


def test_a_rotor_on_a_spring_swings_at_its_resonance() -> None:
    hertz, damping, rad_per_nm = 80.0, 0.05, 1e-4
    brake = {"rad_per_nm": rad_per_nm, "resonance_hz": hertz, "damping": damping}
    plant = plant_of(effects={"brake_compliance": brake}, magnetics=LINEAR)
    x = np.zeros(layout.STATE_LENGTH)
    x[layout.PSI_D], x[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    simulate(plant, np.tile([0.0, 4.25], (3000, 1)), x)  # a torque, until all stands still
    rest = x[layout.THETA]
    assert rest == pytest.approx(rad_per_nm * x[layout.TORQUE], rel=1e-2)
    x[layout.THETA] += 0.02  # let go from there
    angles = np.array([simulate(plant, np.array([[0.0, 4.25]]), x)[1][layout.THETA] for _ in range(600)]) - rest
    ups = np.flatnonzero((angles[:-1] < 0) & (angles[1:] >= 0))
    period = float(np.diff(ups).mean()) / FS
    assert 1.0 / period == pytest.approx(hertz * math.sqrt(1 - damping**2), rel=0.02)
    peaks = [np.abs(angles[a:b]).max() for a, b in itertools.pairwise(ups)]
    decrement = 2 * math.pi * damping / math.sqrt(1 - damping**2)
    assert math.log(peaks[0] / peaks[1]) == pytest.approx(decrement, rel=0.2)


def test_housing_and_room_warm_the_winding_as_well() -> None:
    heat = {
        "rise_per_watt": 1e-3, "time_constant_s": 0.02, "housing_rise_per_watt": 4e-4, "housing_time_constant_s": 0.1,
        "ambient_rise_per_s": 0.01,
    }  # fmt: skip
    plant = plant_of(effects={"winding_heating": heat}, magnetics=LINEAR)
    n, step = 3000, 1000
    v = np.tile([8.5, 0.0], (n, 1))
    x = np.zeros(layout.STATE_LENGTH)
    x[layout.PSI_D], x[layout.COS] = plant.magnetics.energy.psi_m, 1.0
    x[layout.PSI_D] += 2.0 * L[0]
    x[layout.I_ALPHA] = x[layout.READING_A] = x[layout.IRON_D] = 2.0
    for rows in range(step, n + 1, step):
        simulate(plant, v[:step], x)
        t, watts = rows / FS, 1.5 * 8.5 * 2.0
        expected = 1e-3 * watts * -math.expm1(-t / 0.02) + 4e-4 * watts * -math.expm1(-t / 0.1) + 0.01 * t
        assert x[layout.HEAT] == pytest.approx(expected, rel=0.05)
    assert x[layout.AMBIENT] == pytest.approx(0.01 * n / FS)
