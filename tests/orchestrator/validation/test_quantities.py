"""Quantities with units become numbers in the field's own unit, and are reported."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from orchestrator.config import load_motor, read_procedure
from orchestrator.validation.quantities import value_in
from protocols import ProcedureError
from tests.support.processes import called


def test_quantities_become_numbers_in_the_field_s_unit_and_are_stated() -> None:
    written = ["motor.d_inductance_h=43.25 mH", "motor.pm_flux_wb=300mWb", "stages.6.settle_s=500 ms"]
    loaded = read_procedure("quick", overrides=[*written, "stages.4.tolerance_rad=1 deg", "limits.current_a=4500 mA"])
    motor, stages = loaded.procedure.motor, loaded.procedure.stages
    assert (motor.d_inductance_h, motor.pm_flux_wb, loaded.procedure.limits.current_a) == (0.04325, 0.3, 4.5)
    assert (stages[6].settings["settle_s"], stages[4].settings["tolerance_rad"]) == (0.5, pytest.approx(math.pi / 180))
    assert "motor.d_inductance_h: 43.25 mH is read as 0.04325 H" in loaded.notes
    assert len(loaded.notes) == 5


def test_lists_and_motor_files_take_them_too(tmp_path: Path) -> None:
    loaded = read_procedure("quick", overrides=["stages.6.points_a=[[500 mA, 0.0], [2 A, 0]]"])
    assert loaded.procedure.stages[6].settings["points_a"] == [[0.5, 0.0], [2.0, 0]]
    file = tmp_path / "motor.yaml"
    file.write_text("motor: {name: 60 uH motor, pole_pairs: 2, d_inductance_h: 60 uH, rated_speed_rpm: 100 rad/s}")
    motor = load_motor(file)
    assert (motor.name, motor.d_inductance_h) == ("60 uH motor", 60e-6)
    assert motor.rated_speed_rpm == pytest.approx(954.93, rel=1e-5)


@pytest.mark.parametrize("written", ["20 mOhm", "20 mohm", "20 mΩ", "20 m\u2126", "0.02 Ohm", "20000 uOhm", "0.02 Ω"])
def test_an_ohm_is_understood_however_it_is_spelt(written: str) -> None:
    loaded = read_procedure("quick", overrides=[f"motor.stator_resistance_ohm={written}"])
    assert loaded.procedure.motor.stator_resistance_ohm == pytest.approx(0.02)


@pytest.mark.parametrize("written", ["11.8 mVs", "11.8 mWb", "0.0118 Vs"])
def test_a_flux_may_be_in_volt_seconds(written: str) -> None:
    assert read_procedure("quick", overrides=[f"motor.pm_flux_wb={written}"]).procedure.motor.pm_flux_wb == 0.0118


def test_a_unit_of_something_else_is_refused_with_its_place() -> None:
    with pytest.raises(ProcedureError, match=r"motor.d_inductance_h: expected a number in H, .* got '60 uF'"):
        read_procedure("quick", overrides=["motor.d_inductance_h=60 uF"])


def test_check_says_what_it_read() -> None:
    assert (
        "limits.current_a: 4500 mA is read as 4.5 A"
        in called("check", "quick", "--set", "limits.current_a=4500 mA").stdout
    )


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [("0.8", "V", 0.8), ("385 mV", "V", 0.385), ("5.2 deg", "rad", math.radians(5.2)), ("0.3%", "1/W", 0.003)],
)
def test_one_value_is_read_in_a_unit(text: str, unit: str, value: float) -> None:
    assert value_in(text, unit) == pytest.approx(value)


@pytest.mark.parametrize(("text", "unit"), [("385 mA", "V"), ("3 %", "V"), ("x", "V"), ("", "V")])
def test_what_is_no_value_in_a_unit_is_none(text: str, unit: str) -> None:
    assert math.isnan(value_in(text, unit))
