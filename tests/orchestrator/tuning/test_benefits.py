"""What a tuning changes is what the C code and the machine show."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from orchestrator.tuning.benefits import Benefits, benefits_of
from orchestrator.tuning.drive_tuning import no_compensation
from orchestrator.tuning.machine import Machine
from protocols import Motor
from tests.orchestrator.tuning.closed_loop import Loop, Plant
from tests.orchestrator.tuning.machines import flux_map
from tests.orchestrator.tuning.tables import LIMITS, NODES, REACH_A, Tables, tables_of

INVERTER = Plant(dead_time=2e-6, drop_v=1.0, drop_ohm=0.02)


@pytest.fixture(scope="module")
def tables() -> Tables:
    return tables_of(INVERTER)


def machine_of(motor: Motor) -> Machine:
    return Machine(motor, flux_map(INVERTER.psi, REACH_A, nodes=NODES), INVERTER.r_s, 0.0)


def benefits(tables: Tables, motor: Motor | None = None) -> Benefits:
    machine = machine_of(motor or tables.motor)
    return benefits_of(machine, LIMITS, tables.references, tables.control, tables.compensation)


@pytest.mark.slow
def test_the_harmonics_without_compensation_are_those_of_the_c_code_and_its_plant(
    tables: Tables, tmp_path: Path
) -> None:
    found = benefits(tables)
    turn = round(2.0 * math.pi / (found.speed_rad_s * INVERTER.period))
    run = Loop(tables.files(), tmp_path).torque(INVERTER, 0.25 * found.wanted_nm[-1], found.speed_rad_s, 4 * turn)
    spectrum = np.abs(np.fft.rfft(run["phase_a"][-2 * turn :]))
    expected = 100.0 * math.hypot(spectrum[10], spectrum[14]) / spectrum[2]
    print(f"5th and 7th harmonic {found.harmonics_without_percent:.3f} %, by the C code {expected:.3f} %")
    assert found.harmonics_without_percent == pytest.approx(expected, rel=0.03)
    assert found.harmonics_percent < 0.01


def test_an_uncertain_compensation_leaves_some(tables: Tables) -> None:
    compensation = dataclasses.replace(tables.compensation, lost_std_v=np.full(401, 0.1))
    found = benefits(dataclasses.replace(tables, compensation=compensation))
    assert 0.01 < found.harmonics_percent < found.harmonics_without_percent


def test_without_a_loss_there_are_no_harmonics(tables: Tables) -> None:
    found = benefits(dataclasses.replace(tables, compensation=no_compensation(LIMITS.current_a)))
    assert found.harmonics_without_percent == pytest.approx(0.0, abs=1e-9)


def test_constant_inductances_miss_the_torque_that_the_map_gives(tables: Tables) -> None:
    found = benefits(tables)
    assert np.abs(found.by_map_nm - found.wanted_nm).max() < 1e-3 * found.wanted_nm[-1]
    assert found.torque_error_percent > 1.0


def test_a_nameplate_that_is_right_at_one_point_is_right_there(tables: Tables) -> None:
    """Inductances of the chords at a current of the references."""
    i_dq = tables.references.i_dq_a[-1, -1]
    chord = (INVERTER.psi(i_dq) - [INVERTER.psi_m, 0.0]) / i_dq
    motor = tables.motor.model_copy(
        update={"d_inductance_h": chord[0], "q_inductance_h": chord[1], "pm_flux_wb": INVERTER.psi_m}
    )
    assert benefits(tables, motor).torque_error_percent < benefits(tables).torque_error_percent


def test_the_harmonics_are_at_the_same_speed_whatever_the_largest_one_is(tables: Tables) -> None:
    motor = tables.motor.model_copy(update={"rated_speed_rpm": 1500.0})
    speeds = [
        benefits_of(machine_of(motor), limits, tables.references, tables.control, tables.compensation).speed_rad_s
        for limits in (dataclasses.replace(LIMITS, speed_rad_s=speed) for speed in (2000.0, 3000.0))
    ]
    assert speeds[0] == speeds[1]
