"""A mapping file: motor and drive with units, in place or by the path of their own file."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.importing._loading import read_drive, read_mapping
from protocols import InputError

REST = """
format: fluxbench-import
version: 1
name: line to line step with a shunt
drive: {name: bench supply, dc_bus_voltage_v: 5000 mV, pwm_frequency_hz: 20 kHz}
sampling_frequency_hz: 50000
current: {frame: dq, columns: {d: 5 mA, q: i_q}, unit: A, scaling: amplitude_invariant}
voltage: {frame: dq, columns: {d: u_d, q: u_q}, unit: V, scaling: amplitude_invariant}
segments: [{stage: steps}]
"""
MOTOR = "motor: {name: gimbal, pole_pairs: 7, stator_resistance_ohm: 8500 mOhm, d_inductance_h: 5.4 mH}\n"


def test_motor_and_drive_may_have_units_and_what_was_read_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(MOTOR + REST)
    found = read_mapping(path)
    assert found.common.motor.d_inductance_h == pytest.approx(5.4e-3)
    assert found.common.motor.stator_resistance_ohm == pytest.approx(8.5)
    assert found.common.drive.dc_bus_voltage_v == pytest.approx(5.0)
    assert "motor.d_inductance_h: 5.4 mH is read as 0.0054 H" in found.readings
    assert found.common.current.columns["d"] == "5 mA"


def test_so_may_the_motor_s_own_file(tmp_path: Path) -> None:
    (tmp_path / "gimbal.yaml").write_text(MOTOR)
    path = tmp_path / "mapping.yaml"
    path.write_text("motor: gimbal.yaml\n" + REST)
    assert read_mapping(path).common.motor.d_inductance_h == pytest.approx(5.4e-3)


def test_a_unit_of_something_else_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(MOTOR.replace("5.4 mH", "5.4 mF") + REST)
    with pytest.raises(InputError, match=r"mapping.yaml:1.*motor.d_inductance_h: expected a number in H.*'5.4 mF'"):
        read_mapping(path)


def test_a_set_point_beside_a_rules_keys_is_refused_with_where_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(MOTOR + REST.replace("{stage: steps}", "{stage: steps, pwm_frequency_hz: 20000}"))
    with pytest.raises(InputError, match=r"unknown key; a set-point .* settings: \{pwm_frequency_hz: \.\.\.\}"):
        read_mapping(path)


def test_a_log_is_not_of_the_simulated_drive_that_a_motor_file_names(tmp_path: Path) -> None:
    plate = tmp_path / "plate.yaml"
    plate.write_text(MOTOR + "drive: {name: simulated, dc_bus_voltage_v: 48}\n")
    given = read_drive(plate)
    assert given is not None
    assert (given.name, given.dc_bus_voltage_v) == ("unknown", 48.0)
    path = tmp_path / "mapping.yaml"
    rest = REST.replace("{name: bench supply, dc_bus_voltage_v: 5000 mV, pwm_frequency_hz: 20 kHz}", "plate.yaml")
    path.write_text(MOTOR + rest)
    assert read_mapping(path).common.drive.name == "unknown"
