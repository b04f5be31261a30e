"""A nameplate's numbers are held against each other, and the likely slip is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.config import load_motor, load_procedure, nameplate_doubts
from protocols import Motor
from tests.support.processes import called

PAGES = Path(__file__).parents[3] / "docs" / "motors"
MOTOR = load_procedure("demo").motor


def doubts(**slips: float) -> str:
    """What is said of the demo's motor with some fields times a factor."""
    changed = {name: getattr(MOTOR, name) * factor for name, factor in slips.items()}
    return "\n".join(nameplate_doubts(Motor.model_validate({**MOTOR.model_dump(), **changed})))


@pytest.mark.parametrize("motor", [MOTOR, *(load_motor(file) for file in sorted(PAGES.glob("*.yaml")))])
def test_a_sound_nameplate_is_not_doubted(motor: Motor) -> None:
    assert list(nameplate_doubts(motor)) == []


@pytest.mark.parametrize(
    ("slips", "field", "words"),
    [
        ({"d_inductance_h": 1e3, "q_inductance_h": 1e3}, "motor.d_inductance_h and motor.q_inductance_h", "in mH"),
        ({"q_inductance_h": 1e3}, "motor.q_inductance_h: 0.06905", "in mH"),
        ({"pm_flux_wb": 1e3}, "motor.pm_flux_wb: 0.3 would fit", "in mWb"),
        ({"stator_resistance_ohm": 1e3}, "motor.stator_resistance_ohm: 4.25", "in milliohm"),
        ({"rated_power_w": 1e-3}, "motor.rated_power_w: 400", "in kW"),
        ({"pole_pairs": 2}, "motor.pole_pairs: 2", "number of poles"),
    ],
)
def test_the_likely_slip_is_named_with_the_number_that_would_fit(
    slips: dict[str, float], field: str, words: str
) -> None:
    said = doubts(**slips)
    assert field in said
    assert words in said


def test_rms_and_peak_of_a_motor_without_saliency() -> None:
    motor = load_motor(PAGES / "servo-48v.yaml")
    assert motor.pm_flux_wb
    said = list(nameplate_doubts(motor.model_copy(update={"pm_flux_wb": motor.pm_flux_wb / 2**0.5})))
    assert "the rms, not the peak value" in said[-1]


def test_both_numbers_are_said_where_no_slip_explains_them() -> None:
    said = doubts(rated_speed_rpm=1.4)
    assert "60 x 60 Hz / 2 pole pairs = 1800 rpm, and rated_speed_rpm is 2520" in said
    assert "would fit" not in said


def test_what_is_missing_is_not_held_against_anything() -> None:
    assert list(nameplate_doubts(Motor(name="bare", pole_pairs=2, pm_flux_wb=300.0))) == []


def test_check_says_it_and_degrees_are_no_radians() -> None:
    doubted = called("check", "quick", "--set", "motor.rated_power_w=0.4")
    assert doubted.returncode == 0
    assert "motor.rated_power_w: 400 would fit: is what is written in kW?" in doubted.stdout
    degrees = called("check", "quick", "--set", "stages.4.tolerance_rad=90")
    assert degrees.returncode == 2
    assert "stages.4.tolerance_rad: 90 rad is more than two turns: is it in degrees (1.571 rad)?" in degrees.stderr
