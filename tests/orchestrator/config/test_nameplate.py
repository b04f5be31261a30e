"""A nameplate's numbers are held against each other."""

from __future__ import annotations

import pytest

from orchestrator.config import load_procedure, nameplate_doubts
from orchestrator.config._nameplate import broken_relations, completed, mismatch, stated_values
from protocols import Motor
from tests.orchestrator.config.nameplates import SOUND
from tests.support.processes import called

MOTOR = load_procedure("demo").motor


def doubts(**slips: float) -> str:
    """What is stated of the demo's motor with some fields times a factor."""
    changed = {name: getattr(MOTOR, name) * factor for name, factor in slips.items()}
    return "\n".join(nameplate_doubts(Motor.model_validate({**MOTOR.model_dump(), **changed})))


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_nameplate_is_not_doubted(name: str) -> None:
    assert list(nameplate_doubts(SOUND[name])) == []


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_nameplate_is_as_usual_within_chance(name: str) -> None:
    """Of nine independent relations 99.9 % of sums of squares are below 27.9."""
    assert mismatch(stated_values(SOUND[name])) < 27.9


def test_both_numbers_are_stated_where_no_slip_explains_them() -> None:
    stated = doubts(rated_speed_rpm=1.4)
    assert "60 x 60 Hz / 2 pole pairs = 1800 rpm, and rated_speed_rpm is 2520" in stated
    assert "would fit" not in stated


def test_what_is_missing_is_not_held_against_anything() -> None:
    assert list(nameplate_doubts(Motor(name="bare", pole_pairs=2, pm_flux_wb=300.0))) == []


def test_what_follows_from_other_values_is_held_against_the_rest() -> None:
    values = {"pole_pairs": 2.0, "rated_speed_rpm": 1800.0, "rated_power_w": 400.0}
    assert completed(values)["rated_frequency_hz"] == pytest.approx(60.0)
    assert completed(values)["rated_torque_nm"] == pytest.approx(2.122, rel=1e-3)
    (reported,) = broken_relations({**values, "rated_current_rms_a": 1.66, "pm_flux_wb": 3.0})
    assert "rated_torque_nm from the others is 2.122" in reported


def test_a_q_axis_of_less_inductance_is_requested() -> None:
    stated = doubts(d_inductance_h=3.0)
    assert "q_inductance_h / d_inductance_h = 0.06905 H / 0.1297 H = 0.5322" in stated
    assert "d and q exchanged" in stated
    slightly = doubts(d_inductance_h=2.0)
    assert "q_inductance_h / d_inductance_h = 0.06905 H / 0.0865 H = 0.7983" in slightly
    assert "exchanged" not in slightly  # values of a nameplate are a quarter off without any slip


def test_check_says_it_and_degrees_are_no_radians() -> None:
    doubted = called("check", "quick", "--set", "motor.rated_power_w=0.4")
    assert doubted.returncode == 0
    assert "motor.rated_power_w: 400 would fit: is the stated value in kW?" in doubted.stdout
    degrees = called("check", "quick", "--set", "stages.4.tolerance_rad=90")
    assert degrees.returncode == 2
    assert "stages.4.tolerance_rad: 90 rad is more than two turns: is it in degrees (1.571 rad)?" in degrees.stderr


def test_a_refusal_names_the_slip_beside_what_is_refused() -> None:
    refused = called("check", "quick", "--set", "motor.stator_resistance_ohm=4250")
    assert refused.returncode == 2
    slip = "motor.stator_resistance_ohm: 4.25 would fit: is the stated value in milliohm?"
    assert f"=4250: {slip} As it is written, limits.voltage_v: " in refused.stderr


def test_a_limit_of_another_unit_is_named_beside_the_rated_value() -> None:
    refused = called("check", "quick", "--set", "limits.current_a=10 kA")
    assert refused.returncode == 2
    assert (
        "limits.current_a: 10000 A is 4260 times the rated peak (motor.rated_current_rms_a is 1.66 A)" in refused.stderr
    )


def test_a_value_out_of_all_bounds_is_requested_its_unit() -> None:
    refused = called("check", "quick", "--set", "motor.d_inductance_h=43.25")
    assert refused.returncode == 2
    assert "(L / R = 10.2 s): is it in mH? Then write 0.04325" in refused.stderr


@pytest.mark.parametrize(
    ("limit_a", "words"),
    [
        (1.66, "1.66 A is below the rated current's peak of 2.348 A: is it the rms value?"),
        (2.0, "the map will not reach the rated current"),
    ],
)
def test_a_current_limit_below_the_rated_peak_is_noted(limit_a: float, words: str) -> None:
    stated = called("check", "demo", "--set", f"limits.current_a={limit_a}").stdout
    assert words in stated
    assert "rated current's peak" not in called("check", "demo").stdout


def test_check_says_what_is_measured_between_two_terminals() -> None:
    stated = called("check", "demo").stdout
    assert "between two terminals an ohmmeter should read 8.5 Ω and a bridge 86.5 mH" in stated
    assert "if they read 4.25 Ω and 43.2 mH, halve these values in the file" in stated
