from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from orchestrator.tuning.current_control import CurrentControl, current_control
from orchestrator.tuning.drive_tuning import no_compensation
from orchestrator.tuning.firmware_settings import settings_for_firmware
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from tests.orchestrator.tuning.closed_loop import Plant
from tests.orchestrator.tuning.machines import linear, machine

LIMITS = DriveLimits(current_a=3.0, bus_v=300.0, speed_rad_s=1000.0, sampling_hz=1e4, pwm_hz=1e4)


def read(content: bytes) -> dict[str, float]:
    lines = (line.split("#")[0] for line in content.decode("ascii").splitlines())
    return {name.strip(): float(value) for name, value in (line.split("=") for line in lines if line.strip())}


def settings_of(of: Machine) -> tuple[CurrentControl, dict[str, dict[str, float]]]:
    control = current_control(of, LIMITS)
    return control, {name: read(text.encode("ascii")) for name, text in texts_of(of).items()}


def texts_of(of: Machine, **lost: float) -> dict[str, str]:
    """The files of a machine behind an inverter whose legs lose a voltage, in volts and over the bus voltage."""
    control, none = current_control(of, LIMITS), no_compensation(LIMITS.current_a)
    legs = {name: np.array([-value, 0.0, value]) for name, value in lost.items()}
    texts = settings_for_firmware(of, LIMITS, control, dataclasses.replace(none, **legs))  # type: ignore[arg-type]
    return {name: text.decode("ascii") for name, text in texts.items()}


def test_a_machine_without_saturation_gets_the_gains_of_its_inductances() -> None:
    control, settings = settings_of(machine(linear(0.02, 0.05, 0.3)))
    alpha = control.bandwidth_rad_s
    assert settings["vesc.txt"] == pytest.approx(
        {
            "foc_current_kp": 0.02 * alpha,
            "foc_current_ki": alpha,
            "foc_motor_r": 1.0,
            "foc_temp_comp_base_temp": 20.0,
            "foc_motor_l": 0.035,
            "foc_motor_ld_lq_diff": 0.03,
            "foc_motor_flux_linkage": 0.3,
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


def test_each_file_states_which_part_of_the_loss_it_compensates() -> None:
    of = machine(linear(0.02, 0.05, 0.3))
    both = texts_of(of, lost_per_bus_v=0.00625, lost_v=0.39)
    assert read(both["vesc.txt"].encode())["foc_dt_us"] == pytest.approx(0.625)
    assert "390 mV of the 2.27 V is no dead time" in both["vesc.txt"]
    for name in ("odrive.txt", "simplefoc.txt"):
        assert "2.27 V, nothing of it is compensated" in both[name]
    assert "inverter's loss" not in texts_of(of, lost_per_bus_v=0.00625)["vesc.txt"]
    devices = texts_of(of, lost_v=0.39)["vesc.txt"]
    assert "foc_dt_us" not in devices
    assert "390 mV, nothing of it is compensated" in devices


def test_each_file_states_the_temperature_of_r_s_and_a_magnet_that_was_not_measured() -> None:
    of = machine(linear(0.02, 0.05, 0.3))
    for text in texts_of(of).values():
        assert "with the winding at 20 degC (assumed" in text
        assert "the nameplate" not in text
    stated = dataclasses.replace(of, motor=of.motor.model_copy(update={"pm_flux_wb": 0.3}), winding_c=35.0)
    for text in texts_of(stated).values():
        assert "with the winding at 35 degC." in text
        assert "300 mWb, copied from the nameplate, not from a measurement" in text


def test_vesc_gets_the_flux_linkage_or_a_line_that_it_is_missing() -> None:
    of = machine(linear(0.02, 0.05, 0.3))
    beyond = of.flux_map.model_copy(update={"i_d": np.asarray(of.flux_map.i_d) + 100.0})
    control, none = current_control(of, LIMITS), no_compensation(LIMITS.current_a)
    missing = settings_for_firmware(dataclasses.replace(of, flux_map=beyond), LIMITS, control, none)["vesc.txt"]
    assert b"foc_motor_flux_linkage: the map does not reach zero current" in missing


def test_the_stated_phase_margin_is_that_of_the_settings_that_are_written() -> None:
    of = machine(linear(0.02, 0.05, 0.3))
    control, settings = settings_of(of)
    k_p, k_i = settings["vesc.txt"]["foc_current_kp"], settings["vesc.txt"]["foc_current_ki"]
    s = 1j * np.geomspace(1e2, 1e5, 100_000)
    loop = (k_p + k_i / s) / (0.02 * s + of.r_s_ohm) * np.exp(-s * control.delay_s)
    margin_deg = 180.0 + math.degrees(np.angle(loop[np.abs(np.abs(loop) - 1.0).argmin()]))
    for text in texts_of(of).values():
        assert f"phase margin {margin_deg:.0f} deg at standstill" in text


def test_no_current_makes_the_loop_faster_than_the_bandwidth() -> None:
    """The gain in volts per ampere is at most the bandwidth times what a step on that axis meets."""
    plant = Plant(i_d=6.0, i_q=2.0, i_x=3.0, i_y=3.0, cross=2e-4)
    control, settings = settings_of(machine(plant.psi))
    at = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))
    at = at[np.linalg.norm(at, axis=1) <= LIMITS.current_a]
    turn = np.linspace(0.0, 2.0 * math.pi, 361)
    at = np.concatenate([at, LIMITS.current_a * np.column_stack([np.cos(turn), np.sin(turn)])])
    slopes = np.stack([(plant.psi(at + 1e-4 * e) - plant.psi(at - 1e-4 * e)) / 2e-4 for e in np.eye(2)], axis=-1)
    met = 1.0 / np.diagonal(np.linalg.inv(slopes), axis1=1, axis2=2)
    for k, axis in enumerate("dq"):
        gain = settings["simplefoc.txt"][f"PID_current_{axis}.P"]
        assert gain <= 1.001 * control.bandwidth_rad_s * met[:, k].min()
        assert gain >= 0.97 * control.bandwidth_rad_s * met[:, k].min()
    assert settings["vesc.txt"]["foc_current_kp"] <= 1.001 * control.bandwidth_rad_s * met.min()
