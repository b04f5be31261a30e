"""The blind plant's bridge against charges, circuits and its own averaged form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from orchestrator.diagnosis import diagnose_recording
from orchestrator.recording import open_recording
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from tests.blind.campaign import Campaign, record
from tests.blind.delivered import held_against
from tests.blind.drive import CONTROL, OPEN, run
from tests.blind.effects import FOREIGN
from tests.blind.hidden import NUISANCES, Case, draw_case
from tests.blind.magnetics import POINTS, REACH, Array, Table, tabulated
from tests.blind.plant import HEALTHY, MEMORY, STATES, Plant
from tests.blind.switched import NO_BRIDGE, SAG, Bridge, swung
from tests.blind.switched_bench import healthy

TS, R, L_D, L_Q, BUS_V = 1e-4, 4.0, 0.04, 0.07, 540.0
PLAIN = HEALTHY._replace(sample_s=TS, pole_pairs=2.0, resistance=R, bus_v=BUS_V)
EDGES = Bridge(half_s=0.5 * TS)


@pytest.fixture(scope="module")
def linear() -> Table:
    axis = np.linspace(-REACH, REACH, POINTS) * 6.0
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return tabulated(0.5 * L_D * x**2 + 0.5 * L_Q * y**2 + 0.3 * x, axis)


def respond(
    bridge: Bridge, table: Table, wanted: Array, mode: int = OPEN, plant: Plant = PLAIN
) -> tuple[Array, Array, Array]:
    """Currents and voltages from rest, and the memory in the end."""
    n, state, memory = len(wanted), np.zeros(STATES), np.zeros(MEMORY)
    i, v, bus, phases = (np.empty(shape, np.float32) for shape in ((n, 2), (n, 2), n, (n, 3)))
    run(
        plant, table.coefficients, table.low_a, 1.0 / table.step_a, state, memory, np.zeros((5, STATES)), 0.0, 0.0,
        mode, np.array([9.0, 15.0, 900.0, 1500.0]), 300.0, np.asarray(wanted, dtype=np.float64), np.zeros((n, 6)), i, v,
        bridge, bus, phases,
    )  # fmt: skip
    return np.asarray(i, np.float64), np.asarray(v, np.float64), memory


def still(d: float, q: float, count: int = 2500) -> Array:
    return np.tile([d, q], (count, 1))


@pytest.mark.parametrize("i", [-2.0, 0.05, 0.11, 0.3, 2.0])
def test_a_node_s_integral_is_that_of_its_curve(i: float) -> None:
    b = EDGES._replace(charge_c=1e-7, slow_s_per_a=1e-8)
    dead_s, t = 1e-6, np.linspace(0.0, 3e-6, 30001)
    x = np.minimum(t * i / b.charge_c, 1.0)
    helped = np.where(t < dead_s, x - np.sin(2 * np.pi * x) / (2 * np.pi), 1.0)
    node = helped if i > 0 else (t >= dead_s + 1e-8 * abs(i)).astype(float)
    for end in (7000, 15000, 30000):
        area = float(np.trapezoid(node[: end + 1], t[: end + 1]))
        assert swung(b, dead_s, 0.0, float(t[end]), i, 0.0) == pytest.approx(area, abs=2e-10)


@njit(cache=True)
def in_small_steps(legs: Array, dead_s: float, charge: float, periods: int, step: float) -> Array:
    """Currents (periods, 2) at each valley of three nodes that the currents swing, by Euler's method."""
    duty = 0.5 + (legs - 0.5 * (legs.max() + legs.min())) / BUS_V
    out, i, up = np.zeros((periods, 2)), np.zeros(2), np.zeros(3)
    since, flown, node = np.ones(3), np.ones(3), np.ones(3)
    for k in range(round(periods * TS / step)):
        abc = (i[0], 0.5 * (3**0.5 * i[1] - i[0]), -0.5 * (3**0.5 * i[1] + i[0]))
        for leg in range(3):
            wanted = 1.0 if abs(k * step % TS - 0.5 * TS) < duty[leg] * 0.5 * TS else 0.0
            if wanted != up[leg]:
                up[leg], since[leg], flown[leg] = wanted, 0.0, 0.0
            helping = -abc[leg] if wanted else abc[leg]
            flown[leg] = 1.0 if since[leg] >= dead_s else min(max(flown[leg] + helping * step / charge, 0.0), 1.0)
            risen = flown[leg] - np.sin(2 * np.pi * flown[leg]) / (2 * np.pi)
            node[leg] = BUS_V * (risen if wanted else 1.0 - risen)
            since[leg] += step
        i[0] += step / L_D * ((2 * node[0] - node[1] - node[2]) / 3 - R * i[0])
        i[1] += step / L_Q * ((node[1] - node[2]) / 3**0.5 - R * i[1])
        out[k // round(TS / step)] = i
    return out


@pytest.mark.parametrize("still_v", [(0.4, 0.3), (5.0, -2.0), (0.0, 40.0)])
def test_nodes_that_swing_by_their_currents_go_as_in_steps_of_a_nanosecond(
    linear: Table, still_v: tuple[float, float]
) -> None:
    dead_s, charge = 1.2e-6, 3e-8
    read, _, _ = respond(EDGES._replace(dead_s=dead_s, dead_a_s=dead_s, charge_c=charge), linear, still(*still_v, 40))
    v, u = still_v
    legs = np.array([v, 0.5 * (3**0.5 * u - v), -0.5 * (3**0.5 * u + v)])
    expected = in_small_steps(legs, dead_s, charge, 30, 1e-9)
    np.testing.assert_allclose(read[1:31], expected, rtol=2e-3, atol=0.01 * charge / dead_s)


def test_without_losses_the_bridge_gives_the_mean_voltage(linear: Table) -> None:
    square = np.where(np.arange(400) % 20 < 10, 40.0, -40.0)[:, None] * [[0.8, 0.6]] + [[6.0, 3.0]]
    averaged, _, _ = respond(NO_BRIDGE, linear, square)
    switched, _, _ = respond(EDGES, linear, square)
    assert np.abs(switched - averaged).max() < 2e-4 * np.abs(averaged).max()


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_dead_time_loses_its_share_of_the_bus_less_the_swing(linear: Table, ratio: float) -> None:
    """e = f V (t_d - Q / (2 |i|)) in each phase."""
    dead_s, charge = 1e-6, 6e-8
    b = EDGES._replace(half_s=EDGES.half_s / ratio, dead_s=dead_s, dead_a_s=dead_s, charge_c=charge)
    i, v, _ = respond(b, linear, still(2.0, 0.0, 5000), CONTROL)

    def lost(size: float) -> float:
        return ratio / TS * BUS_V * (dead_s - 0.5 * charge / size)

    assert i[-1] == pytest.approx([2.0, 0.0], abs=2e-3)
    assert v[-1, 0] - R * i[-1, 0] == pytest.approx((2 * lost(2.0) + 2 * lost(1.0)) / 3, rel=1e-2)


def test_near_zero_current_less_is_lost(linear: Table) -> None:
    b = EDGES._replace(dead_s=1e-6, dead_a_s=1e-6, charge_c=1e-7)
    _, v, _ = respond(b, linear, still(0.02, 0.0, 5000), CONTROL)
    assert v[-1, 0] - R * 0.02 < 0.4 * (4.0 / 3.0) * 1e-6 / TS * BUS_V


def test_a_drop_is_the_logarithm_of_the_current(linear: Table) -> None:
    b = EDGES._replace(switch_v=0.8, diode_v=0.8, knee_a=0.01)
    _, v, _ = respond(b, linear, still(2.0, 0.0, 5000), CONTROL)

    def drop(i: float) -> float:
        return float(0.8 * np.log1p(i / 0.01) / np.log1p(1.0 / 0.01))

    assert v[-1, 0] - 2.0 * R == pytest.approx((2 * drop(2.0) + 2 * drop(1.0)) / 3, rel=2e-2)


def test_a_bus_behind_a_resistance_sinks_by_what_is_drawn(linear: Table) -> None:
    b = EDGES._replace(source_ohm=3.0, bus_f=4e-3)
    i, v, memory = respond(b, linear, still(30.0, 0.0))
    drawn = 1.5 * v[-1, 0] * i[-1, 0] / BUS_V
    assert memory[SAG] == pytest.approx(3.0 * drawn, rel=1e-2)


def test_a_small_capacitor_on_a_stiff_source_settles(linear: Table) -> None:
    """Its time constant is a hundredth of a carrier's half period."""
    b = EDGES._replace(source_ohm=5e-3, bus_f=1e-4)
    i, _, memory = respond(b, linear, still(30.0, 0.0))
    # Within a half period it follows what is drawn just then: of one leg's current nothing, or all.
    assert 0.0 <= memory[SAG] <= 5e-3 * abs(i[-1, 0]) * 1.01
    assert np.isfinite(i).all()


def test_a_reading_off_the_valley_is_off_by_the_zero_vector_s_slope(linear: Table) -> None:
    plain, _, _ = respond(EDGES, linear, still(30.0, 0.0))
    late, _, _ = respond(EDGES._replace(late_s=4e-6), linear, still(30.0, 0.0))
    assert late[-1, 0] - plain[-1, 0] == pytest.approx(-4e-6 * R * plain[-1, 0] / L_D, rel=2e-2)


@pytest.mark.slow
def test_a_small_inductance_behind_a_bridge_is_its_own_map(tmp_path: Path) -> None:
    servo = draw_case("nuisance", list(NUISANCES).index("servo_48v"), 7)
    case = replace(servo, bench=healthy(servo.bench))
    recording = open_recording(record(case.bench, case.campaign, tmp_path / "servo"))
    library = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
    found = diagnose_recording(recording, library, out=tmp_path)
    assert found.report.verdict == "clean"
    assert found.delivery is not None
    assert held_against(case, found.delivery.map, found.delivery.resistance, usable=True).map_percent < 0.1


@pytest.mark.slow
def test_three_sensors_are_in_the_recording_with_the_bus_as_logged(tmp_path: Path) -> None:
    case = next(c for n in range(99) if (c := draw_case("switched", n, 1)).bench.bridge.gain_c > 0.0)
    path = record(case.bench, Campaign(short_s=0.02, classical=False, dwells=False), tmp_path / "three")
    recording = open_recording(path)
    capture = recording.load(next(iter(recording.segments())))
    assert capture.i_abc is not None
    a, b, c = capture.i_abc.T
    assert capture.i_ab == pytest.approx(np.column_stack(((2 * a - b - c) / 3, (b - c) / np.sqrt(3))), abs=1e-6)


def test_an_ordinary_bench_behind_a_bridge_has_a_dead_time_and_is_drawn_alike_each_time() -> None:
    def parts(case: Case) -> tuple[object, ...]:
        return case.label, case.truths, case.brought, case.bench.plant, case.bench.bridge

    cases = [draw_case("switched", n, 3) for n in range(12)]
    assert all("dead_time" in {truth.name for truth in case.truths} for case in cases)
    assert all(case.bench.plant.dead_v == 0.0 < case.bench.bridge.dead_s for case in cases)
    assert {"sampling_offset" in case.brought for case in cases} == {True, False}
    assert parts(cases[5]) == parts(draw_case("switched", 5, 3))
    clean = draw_case("switched_clean", 2, 3)
    assert clean.bench.bridge == Bridge(half_s=0.5 / clean.bench.machine.sampling_hz)


def test_what_no_catalogue_has_is_hidden_behind_dead_time_and_behind_a_bridge_too() -> None:
    behind = draw_case("foreign_behind", 5, 3)
    assert behind.foreign == list(FOREIGN)[5]
    assert [(truth.name, truth.size) for truth in behind.truths] == [("dead_time", 1.0)]
    assert behind.bench.plant.dead_v == pytest.approx(8.0)
    slow = draw_case("switched_foreign", 1, 3)
    assert slow.foreign is not None
    assert slow.bench.bridge.dead_a_s > slow.bench.bridge.dead_s + 1.9e-7


@pytest.mark.parametrize("once", [0.0, 1.0], ids=["an edge counts from its own turn", "one comparison makes both"])
def test_edges_meet_whole_ticks(linear: Table, once: float) -> None:
    b = EDGES._replace(tick_s=0.93e-6, once=once)
    i, _, _ = respond(b, linear, still(8.0, 3.0))
    a, b_leg = 8.0, 0.5 * (3.0**0.5 * 3.0 - 8.0)
    legs = np.array([a, b_leg, -a - b_leg])
    duty = 0.5 + (legs - 0.5 * (legs.max() + legs.min())) / BUS_V
    whole = np.floor(duty * b.half_s / b.tick_s)
    on_s = 2.0 * whole if once else whole + b.half_s / b.tick_s - np.floor((1.0 - duty) * b.half_s / b.tick_s)
    felt = BUS_V * on_s * b.tick_s / TS
    expected = np.array([(2 * felt[0] - felt[1] - felt[2]) / 3, (felt[1] - felt[2]) / 3**0.5]) / R
    np.testing.assert_allclose(i[-500:].mean(axis=0), expected, atol=2e-3)
