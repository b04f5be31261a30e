"""The blind plant against physics: circuits with known solutions, energy, convergence, the order of things in time."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.drive import CONTROL, OFF, OPEN, run
from tests.blind.magnetics import POINTS, REACH, Array, Table, tabulated
from tests.blind.plant import HEALTHY, LOOSE, MEMORY, STATES, Plant
from tests.blind.switched import NO_BRIDGE
from tests.blind.switched_bench import FIRM

TS = 1e-4
R, L_D, L_Q = 4.0, 0.04, 0.07
HEALTHY_400 = HEALTHY._replace(sample_s=TS, pole_pairs=2.0, resistance=R, bus_v=540.0)


@pytest.fixture(scope="module")
def linear() -> Table:
    axis = np.linspace(-REACH, REACH, POINTS) * 6.0
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return tabulated(0.5 * L_D * x**2 + 0.5 * L_Q * y**2 + 0.3 * x, axis)


def respond(
    plant: Plant, table: Table, wanted: Array, mode: int = OPEN, believed: float = 0.0
) -> tuple[Array, Array, Array]:
    """Currents and voltages in the believed frame, and the final state, from rest and without noise."""
    state, memory = np.zeros(STATES), np.zeros(MEMORY)
    i, v = np.empty((len(wanted), 2), np.float32), np.empty((len(wanted), 2), np.float32)
    gains = np.array([9.0, 15.0, 900.0, 1500.0])
    run(
        plant, table.coefficients, table.low_a, 1.0 / table.step_a, state, memory, np.zeros((5, STATES)), 0.0, believed,
        mode, gains, 300.0, np.asarray(wanted, dtype=np.float64), np.zeros((len(wanted), 6)), i, v, NO_BRIDGE,
        np.empty(len(wanted), np.float32), np.empty((len(wanted), 3), np.float32),
    )  # fmt: skip
    c, s = np.cos(believed), np.sin(believed)
    turn = np.array([[c, -s], [s, c]])
    return np.asarray(i @ turn, np.float64), np.asarray(v @ turn, np.float64), state


def steps(d: float, q: float, count: int = 1500) -> Array:
    return np.tile([d, q], (count, 1))


def test_a_voltage_step_charges_the_inductances_exponentially(linear: Table) -> None:
    i, _, _ = respond(HEALTHY_400, linear, steps(8.0, 4.0), believed=0.7)
    t = TS * np.arange(len(i))
    assert i[:, 0] == pytest.approx(8.0 / R * -np.expm1(-R * t / L_D), abs=1e-5)
    assert i[:, 1] == pytest.approx(4.0 / R * -np.expm1(-R * t / L_Q), abs=1e-5)


def test_a_row_holds_the_current_before_its_voltage_acts(linear: Table) -> None:
    i, _, _ = respond(HEALTHY_400, linear, steps(8.0, 0.0, 3))
    assert i[0, 0] == 0.0
    assert i[1, 0] == pytest.approx(8.0 * TS / L_D, rel=0.01)


@pytest.mark.parametrize("delay", [0.3, 1.0, 1.4])
def test_a_delayed_voltage_acts_later(linear: Table, delay: float) -> None:
    prompt, _, _ = respond(HEALTHY_400, linear, steps(8.0, 0.0, 400))
    late, _, _ = respond(HEALTHY_400._replace(delay_samples=delay), linear, steps(8.0, 0.0, 400))
    t = TS * np.arange(400)
    assert late[:, 0] == pytest.approx(8.0 / R * -np.expm1(-R * np.maximum(t - delay * TS, 0.0) / L_D), abs=1e-5)
    assert not np.allclose(prompt, late, atol=1e-4)


def test_current_control_reaches_its_set_point(linear: Table) -> None:
    i, v, _ = respond(HEALTHY_400, linear, steps(2.0, -1.0, 4000), CONTROL, believed=-2.0)
    assert i[-1] == pytest.approx([2.0, -1.0], abs=2e-3)
    assert v[-1] == pytest.approx([2.0 * R, -1.0 * R], rel=2e-3)


def test_nothing_flows_with_the_gates_off(linear: Table) -> None:
    i, v, state = respond(HEALTHY_400._replace(offset_a=0.02), linear, steps(9.0, 9.0, 50), OFF)
    assert not v.any()
    assert i[:, 0] == pytest.approx(0.02)
    assert not state.any()


WHOLE = HEALTHY_400._replace(
    dead_v=4.0, dead_a=0.08, skin_ohm=1.0, eddy_ohm=800.0, eddy_s=2e-5, loop_a=0.05, loop_per_wb=1.0, loop_power=2.0,
    twist=0.01, twist_s=2e-3, sag_per_watt=1e-5, heat_fast=0.003, heat_fast_s=30.0, filter_s=1e-5,
)  # fmt: skip


def test_finer_steps_converge(linear: Table) -> None:
    square = np.where(np.arange(600) % 20 < 10, 40.0, -40.0)[:, None] * [[0.8, 0.6]] + [[6.0, 3.0]]
    coarse, fine, finest = (respond(WHOLE._replace(substeps=n), linear, square)[0] for n in (8, 16, 32))
    # A fiftieth of the sensors' noise with the steps in use; the hysteresis' corner keeps it from falling as h^4.
    error = np.abs(coarse - finest).max()
    assert error < 8e-5
    assert np.abs(fine - finest).max() < 0.6 * error


def test_hysteresis_and_eddies_only_take_energy(linear: Table) -> None:
    """Over whole periods the work at the flux, integral of i dpsi, is what the iron burns."""
    t = TS * np.arange(4000)
    wave = 60.0 * np.sin(2 * np.pi * 20.0 * t)[:, None] * [[0.0, 1.0]]
    plain = HEALTHY_400._replace(substeps=8, loop_power=2.0, eddy_s=2e-5, viscous_s=0.01)
    for plant in (
        plain._replace(loop_a=0.05, loop_per_wb=1.0), plain._replace(eddy_ohm=500.0), plain._replace(viscous_per_wb=1.0)
    ):  # fmt: skip
        i, v, _ = respond(plant, linear, wave)
        last = slice(3000, 3500)
        mean = 0.5 * (i[last] + i[3001:3501])
        burnt = TS * (v[last] * mean - R * mean**2).sum()
        healthy, _, _ = respond(HEALTHY_400, linear, wave)
        assert burnt > 1e-4
        assert np.abs(i - healthy).max() > 5e-3


def test_a_hysteresis_loop_does_not_depend_on_its_speed(linear: Table) -> None:
    areas = []
    for slow in (1, 2):
        count = 2000 * slow
        t = np.arange(3 * count) / count
        i_ref = np.stack([np.zeros(3 * count), 2.0 * np.sin(2 * np.pi * t)], axis=1)
        plant = HEALTHY_400._replace(loop_a=0.1, loop_per_wb=1.5, loop_power=2.0)
        i, v, _ = respond(plant, linear, i_ref, CONTROL)
        rise = TS * (v[:, 1] - R * i[:, 1])
        last = slice(2 * count, 3 * count)
        areas.append(float((rise[last] * i[last, 1]).sum()))
    assert areas[0] == pytest.approx(areas[1], rel=0.05)
    assert areas[0] > 1e-3


@pytest.mark.parametrize(("power", "low", "high"), [(1.1, 0.0, 0.5), (FIRM, 0.9, 1.02)])
def test_a_firm_hysteresis_keeps_its_loop_under_a_bridges_ripple(
    linear: Table, power: float, low: float, high: float
) -> None:
    t = TS * np.arange(4000)
    wave = 3.0 * np.sin(2 * np.pi * 20.0 * t)[:, None] * [[0.0, 1.0]]
    plant = HEALTHY_400._replace(substeps=8, loop_a=0.012, loop_per_wb=0.7, loop_power=power)
    held = []
    for ripple in (0.0, 20.0):
        v = wave + ripple * np.where(np.arange(4000) % 2 == 0, 1.0, -1.0)[:, None] * [[0.0, 1.0]]
        i, _, _ = respond(plant, linear, v)
        healthy, _, _ = respond(HEALTHY_400._replace(substeps=8), linear, v)
        off = (i - healthy)[2000:, 1].reshape(-1, 2).mean(axis=1)
        held.append(float(np.sqrt(np.mean(off**2))))
    assert low < held[1] / held[0] < high


def test_a_warm_winding_has_more_resistance(linear: Table) -> None:
    plant = HEALTHY_400._replace(heat_fast=0.003, heat_fast_s=0.1)
    i, v, state = respond(plant, linear, steps(2.0, 0.0, 20_000), CONTROL)
    loss = 1.5 * v[-1, 0] * i[-1, 0]
    assert v[-1, 0] / i[-1, 0] == pytest.approx(R * (1 + 0.003 * loss), rel=2e-3)
    assert state.any()


def test_a_locked_rotor_in_a_wrong_frame_is_a_turned_machine(linear: Table) -> None:
    straight, _, _ = respond(HEALTHY_400, linear, steps(8.0, 0.0), believed=0.05)
    turned, _, _ = respond(HEALTHY_400._replace(angle=0.05), linear, steps(8.0, 0.0))
    along = straight @ np.array([[np.cos(0.05), np.sin(0.05)], [-np.sin(0.05), np.cos(0.05)]])
    assert not np.allclose(turned, along, atol=1e-4)
    assert np.abs(turned[300:, 1]).max() > 1e-3


def test_what_is_left_out_is_absent(linear: Table) -> None:
    healthy, _, _ = respond(HEALTHY_400, linear, steps(8.0, 4.0, 300))
    explicit, _, _ = respond(HEALTHY_400._replace(dead_v=0.0, hum_a=0.0, stick_a=0.0), linear, steps(8.0, 4.0, 300))
    assert np.array_equal(healthy, explicit)
    assert LOOSE < MEMORY
