"""Limits of a drive: given, else the nameplate's and the recording's."""

from __future__ import annotations

import math

import pytest

from orchestrator.tuning.limits import limits_of
from protocols import DriveRecord, InputError
from tests.orchestrator.tuning.machines import linear, machine

MADE = machine(linear(0.04, 0.07, 0.3), reach_a=4.0)
DRIVE = DriveRecord(name="bench", sampling_frequency_hz=20e3, pwm_frequency_hz=10e3, dc_bus_voltage_v=300.0)


def test_limits_come_from_nameplate_and_drive() -> None:
    limits = limits_of(MADE, DRIVE)
    assert limits.current_a == pytest.approx(2.0 * math.sqrt(2.0))
    assert (limits.bus_v, limits.sampling_hz) == (300.0, 10e3)
    assert limits.speed_rad_s == pytest.approx(3000.0 * 2 * math.pi / 30.0)
    assert limits.voltage_v == pytest.approx(300.0 / math.sqrt(3.0))


def test_what_is_given_comes_first() -> None:
    limits = limits_of(MADE, DRIVE, current_a=1.5, bus_v=48.0, speed_rpm=500.0, sampling_hz=8e3)
    assert (limits.current_a, limits.bus_v, limits.sampling_hz) == (1.5, 48.0, 8e3)


def test_a_double_update_leaves_the_pwm_frequency_the_recordings() -> None:
    limits = limits_of(MADE, DRIVE, sampling_hz=20e3)
    assert (limits.sampling_hz, limits.pwm_hz) == (20e3, 10e3)
    limits = limits_of(MADE, DRIVE, pwm_hz=16e3)
    assert (limits.sampling_hz, limits.pwm_hz) == (16e3, 16e3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"current_a": 9.0}, "beyond the map"),
        ({"bus_v": 1.0}, "R_s alone takes"),
        (
            {"bus_v": 5.0},
            r"R_s alone takes 2.83 V of the 2.74 V .* give a bus above 5.16 V \(--bus-v\) or",
        ),
        ({"speed_rpm": -3.0}, "expected a positive number"),
        ({"speed_rpm": math.nan}, "expected a positive number"),
        ({"speed_rpm": 9e5}, "samples in an electrical turn"),
        ({"speed_rpm": 1e-3}, "expected 1 or more"),
        ({"bus_v": 1e6}, "expected 100000 or less"),
        ({"sampling_hz": 10.0}, "is it in the right unit"),
        ({"current_a": 1e-3}, "expected 0.0566 or more"),
    ],
)
def test_limits_that_cannot_be_are_refused(given: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        limits_of(MADE, DRIVE, **given)


def test_a_map_file_needs_bus_and_frequency() -> None:
    with pytest.raises(InputError, match="--bus-v"):
        limits_of(MADE, None)
    with pytest.raises(InputError, match="--sampling-hz"):
        limits_of(MADE, None, bus_v=300.0)
