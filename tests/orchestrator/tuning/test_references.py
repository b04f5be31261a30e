"""Current references: least current for a torque within a flux limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import CurrentReferences, current_references, flux_limit, largest_torque
from protocols import InputError
from tests.orchestrator.tuning.machines import linear, machine, saturated
from tests.support.cases import few

LIMITS = DriveLimits(current_a=2.8, bus_v=300.0, speed_rad_s=700.0, sampling_hz=10e3, pwm_hz=10e3)
BURIED = (0.03, 0.07, 0.25)
MACHINES = {
    "buried magnets": machine(linear(*BURIED)),
    "saturated": machine(saturated()),
    "no magnet": machine(linear(0.12, 0.03, 0.0)),
}


@cache
def references_of(name: str) -> CurrentReferences:
    return current_references(MACHINES[name], LIMITS)


@pytest.fixture(params=["no magnet", "saturated", pytest.param("buried magnets", marks=pytest.mark.slow)])
def tuned(request: pytest.FixtureRequest) -> tuple[Machine, CurrentReferences]:
    return MACHINES[request.param], references_of(request.param)


def test_every_node_gives_its_torque_within_current_and_flux_limit(tuned: tuple[Machine, CurrentReferences]) -> None:
    made, references = tuned
    nodes = references.i_dq_a.reshape(-1, 2)
    wanted = (references.torque_limit_nm[:, None] * references.share).reshape(-1)
    psi = np.repeat(references.psi_limit_wb, len(references.share))
    assert np.abs(made.torque_nm(nodes) - wanted).max() < 1e-3 * references.torque_limit_nm[-1]
    assert np.linalg.norm(nodes, axis=1).max() <= LIMITS.current_a * (1.0 + 1e-9)
    assert (np.linalg.norm(made.psi(nodes), axis=1) <= psi * (1.0 + 1e-4)).all()


def test_torque_between_the_nodes_is_right_to_half_a_percent(tuned: tuple[Machine, CurrentReferences]) -> None:
    made, references = tuned
    rng = np.random.default_rng(1)
    psi = rng.uniform(references.psi_limit_wb[0], references.psi_limit_wb[-1], 5000)
    torque = rng.uniform(-1.0, 1.0, 5000) * np.interp(psi, references.psi_limit_wb, references.torque_limit_nm)
    error = made.torque_nm(references.at(torque, psi)) - torque
    assert math.sqrt(float(np.mean(error**2))) < 0.005 * references.torque_limit_nm[-1]


def test_copper_loss_is_that_of_a_dense_search(tuned: tuple[Machine, CurrentReferences]) -> None:
    made, references = tuned
    axis = np.linspace(-LIMITS.current_a, LIMITS.current_a, 1201)
    plane = np.stack(np.meshgrid(axis, axis[600:], indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[np.linalg.norm(plane, axis=1) <= LIMITS.current_a]
    torque, flux, loss = made.torque_nm(plane), np.linalg.norm(made.psi(plane), axis=1), np.sum(plane**2, axis=1)
    for k in (0, len(references.psi_limit_wb) // 2, len(references.psi_limit_wb) - 1):
        for j in (8, 16, 24):
            wanted = references.torque_limit_nm[k] * references.share[j]
            least = float(loss[(torque >= wanted) & (flux <= references.psi_limit_wb[k])].min())
            # The search's own grid is coarser than the difference.
            assert float(np.sum(references.i_dq_a[k, j] ** 2)) <= 1.001 * least


def test_without_saturation_mtpa_is_the_closed_form() -> None:
    l_d, l_q, magnet = BURIED
    references = references_of("buried magnets")
    i_d, i_q = references.i_dq_a[-1, 1:].T
    expected = magnet / (2.0 * (l_q - l_d)) - np.sqrt((magnet / (2.0 * (l_q - l_d))) ** 2 + i_q**2)
    assert i_d == pytest.approx(expected, abs=2e-3)


def test_a_negative_torque_has_the_opposite_q_current() -> None:
    references = references_of("saturated")
    psi = np.full(2, references.psi_limit_wb[3])
    motoring, braking = references.at(np.array([0.4, -0.4]), psi)
    assert braking == pytest.approx(motoring * [1.0, -1.0])


def test_torque_beyond_the_limit_is_limited() -> None:
    references = references_of("saturated")
    psi = references.psi_limit_wb[[-1]]
    at = references.at(np.array([1e3]), psi)
    assert at[0] == pytest.approx(references.i_dq_a[-1, -1])


def test_a_speed_beyond_reach_is_said() -> None:
    within = references_of("saturated")
    beyond = current_references(
        MACHINES["saturated"], DriveLimits(current_a=0.5, bus_v=60.0, speed_rad_s=5000.0, sampling_hz=10e3, pwm_hz=10e3)
    )
    assert (within.reaches_speed, beyond.reaches_speed) == (True, False)


@pytest.mark.parametrize("speed", [0.0, 400.0, -400.0])
def test_the_flux_limit_follows_voltage_and_speed(speed: float) -> None:
    held: NDArray[np.float64] = flux_limit(LIMITS, 1.0, 2.0, speed)
    expected = math.inf if speed == 0.0 else (0.95 * 300.0 / math.sqrt(3.0) - 2.0) / 400.0
    assert float(held) == pytest.approx(expected)


def test_a_machine_without_magnet_and_saliency_is_refused() -> None:
    for difference in (0.0, 1e-7):
        with pytest.raises(InputError, match="gives torque, by magnet or saliency"):
            current_references(machine(linear(0.05, 0.05 + difference, 0.0)), LIMITS)


@few(
    "known, message",
    [
        (lambda d, q: np.hypot(d, q) > 1.5, "the map has holes, or lacks currents near zero"),
        (lambda d, q: d > 1.5, "the map has holes, or lacks currents near zero"),
        (lambda d, q: (np.abs(d) > 3.9) & (np.abs(q) > 3.9), "gives torque"),
    ],
)
def test_a_map_that_lacks_what_the_references_need_is_refused(
    known: Callable[[Array, Array], Array], message: str
) -> None:
    whole = machine(saturated())
    axes = (np.asarray(axis, dtype=np.float64) for axis in (whole.flux_map.i_d, whole.flux_map.i_q))
    i_d, i_q = np.meshgrid(*axes, indexing="ij")
    kept = known(i_d, i_q)
    tables = {name: np.where(kept, getattr(whole.flux_map, name), np.nan) for name in ("psi_d", "psi_q")}
    holed = Machine(whole.motor, whole.flux_map.model_copy(update=tables), 1.0, 0.01)
    with pytest.raises(InputError, match=message):
        current_references(holed, LIMITS)


def test_the_largest_torque_continues_the_references_and_falls_to_nothing() -> None:
    made, references = MACHINES["buried magnets"], references_of("buried magnets")
    at_nodes = largest_torque(made, LIMITS, references.psi_limit_wb[::8])
    assert at_nodes == pytest.approx(references.torque_limit_nm[::8], rel=1e-6)
    smaller = largest_torque(made, LIMITS, references.psi_limit_wb[0] * np.array([0.0, 0.5, 0.9, 1.0]))
    assert smaller[0] == 0.0
    assert (np.diff(smaller) >= 0.0).all()
