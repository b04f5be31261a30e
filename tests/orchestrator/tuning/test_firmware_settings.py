from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from orchestrator.tuning.current_control import CurrentControl, current_control
from orchestrator.tuning.firmware_settings import settings_for_firmware
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from protocols import InputError
from tests.orchestrator.tuning.closed_loop import Plant
from tests.orchestrator.tuning.machines import linear, machine

LIMITS = DriveLimits(current_a=3.0, bus_v=300.0, speed_rad_s=1000.0, sampling_hz=1e4, pwm_hz=1e4)


def read(content: bytes) -> dict[str, float]:
    lines = (line.split("#")[0] for line in content.decode("ascii").splitlines())
    return {name.strip(): float(value) for name, value in (line.split("=") for line in lines if line.strip())}


def settings_of(of: Machine) -> tuple[CurrentControl, dict[str, dict[str, float]]]:
    control = current_control(of, LIMITS)
    return control, {name: read(text) for name, text in settings_for_firmware(control, LIMITS).items()}


def test_a_machine_without_saturation_gets_the_gains_of_its_inductances() -> None:
    control, settings = settings_of(machine(linear(0.02, 0.05, 0.3)))
    alpha = control.bandwidth_rad_s
    assert settings["vesc.txt"] == pytest.approx(
        {
            "foc_current_kp": 0.02 * alpha,
            "foc_current_ki": alpha,
            "foc_motor_r": 1.0,
            "foc_motor_l": 0.035,
            "foc_motor_ld_lq_diff": 0.03,
        },
        rel=1e-4,
    )
    assert settings["odrive.txt"] == pytest.approx(
        {"current_control_bandwidth": alpha, "phase_inductance": 0.02, "phase_resistance": 1.0}, rel=1e-4
    )
    assert settings["simplefoc.txt"] == pytest.approx(
        {
            "PID_current_d.P": 0.02 * alpha,
            "PID_current_d.I": alpha,
            "PID_current_q.P": 0.05 * alpha,
            "PID_current_q.I": alpha,
            "PID_current_d.limit": 300.0 / math.sqrt(3.0),
            "PID_current_q.limit": 300.0 / math.sqrt(3.0),
            "LPF_current_d.Tf": 0.0,
            "LPF_current_q.Tf": 0.0,
        },
        rel=1e-4,
    )


def test_vesc_gets_the_time_that_a_leg_loses() -> None:
    control = current_control(machine(linear(0.02, 0.05, 0.3)), LIMITS)
    text = settings_for_firmware(control, LIMITS, lost_time_s=625e-9)["vesc.txt"]
    assert read(text)["foc_dt_us"] == pytest.approx(0.625)


def test_vesc_gets_the_flux_linkage_or_a_line_that_it_is_missing() -> None:
    of = machine(linear(0.02, 0.05, 0.3))
    control = current_control(of, LIMITS)
    known = settings_for_firmware(control, LIMITS, of.flux_map)["vesc.txt"]
    assert read(known)["foc_motor_flux_linkage"] == pytest.approx(0.3)
    assert b"foc_motor_flux_linkage is missing" in settings_for_firmware(control, LIMITS)["vesc.txt"]


def test_no_current_makes_the_loop_faster_than_the_bandwidth() -> None:
    """The gain in volts per ampere is at most the bandwidth times what a step on that axis meets."""
    plant = Plant(i_d=6.0, i_q=2.0, i_x=3.0, i_y=3.0, cross=2e-4)
    control, settings = settings_of(machine(plant.psi))
    at = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))
    at = at[np.linalg.norm(at, axis=1) <= LIMITS.current_a]
    slopes = np.stack([(plant.psi(at + 1e-4 * e) - plant.psi(at - 1e-4 * e)) / 2e-4 for e in np.eye(2)], axis=-1)
    met = 1.0 / np.diagonal(np.linalg.inv(slopes), axis1=1, axis2=2)
    for k, axis in enumerate("dq"):
        gain = settings["simplefoc.txt"][f"PID_current_{axis}.P"]
        assert gain <= 1.001 * control.bandwidth_rad_s * met[:, k].min()
        assert gain >= 0.7 * control.bandwidth_rad_s * met[:, k].min()
    assert settings["vesc.txt"]["foc_current_kp"] <= 1.001 * control.bandwidth_rad_s * met.min()


def test_an_inductance_that_is_not_positive_is_refused() -> None:
    control = current_control(machine(linear(0.02, 0.05, 0.3)), LIMITS)
    with pytest.raises(InputError, match="not positive"):
        settings_for_firmware(dataclasses.replace(control, inductance_h=-control.inductance_h), LIMITS)
