"""The figures of a tuning in words: each says at which speed it holds, and what is a limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orchestrator.tuning.benefits import ripple_of
from orchestrator.tuning.tuning_report import TuningReport
from orchestrator.tuning.words import figure_rows, file_rows, headline, notes


def a_report(**changed: object) -> TuningReport:
    fields: dict[str, object] = {
        "motor": "motor", "recording": "run", "method": "injection", "current_limit_a": 2.35, "bus_v": 394.0,
        "sampling_hz": 1e4, "largest_torque_nm": 2.1, "base_speed_rpm": 3156.0, "largest_speed_rpm": 1800.0,
        "torque_at_largest_speed_nm": 2.1, "bandwidth_hz": 447.5, "phase_margin_deg": 60.0,
        "least_phase_margin_deg": 60.0, "margin_speeds_rpm": (0.0, 1800.0), "margins_deg": (60.0, 58.0),
        "integral_hz": 44.75, "integral_limit_v": 227.0, "r_s_ohm": 4.25, "r_s_at_c": 20.0, "delay_s": 1.5e-4,
        "compensated": (), "left_out": {}, "lost_v": 0.0, "constant_inductance_error_percent": 1.0,
        "low_speed_rpm": 36.0, "harmonics_percent": 0.0, "harmonics_without_percent": 0.0,
        "injection_works_percent": 100.0, "injection_error_deg": 23.5, "injection_error_at_a": (0.4, 2.3),
        "injection_within_limit_a": 0.66, "injection_left_by_map_deg": 0.295,
        "observer_speed_rpm": 45.0, "observer_speed_warm_rpm": 356.0,
    }  # fmt: skip
    return TuningReport.model_validate(fields | changed)


def test_a_torque_that_the_speed_limit_ends_is_told_from_one_that_the_voltage_ends() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["largest torque"].startswith("2.1 Nm at every speed up to the limit of 1800 rpm; the voltage")
    rows = dict(figure_rows(a_report(largest_speed_rpm=4000.0, torque_at_largest_speed_nm=1.58)))
    assert rows["largest torque"] == "2.1 Nm up to 3156 rpm; beyond, the voltage limits it"
    assert rows["... left at the largest speed"] == "1.58 Nm at 4000 rpm"


def test_injection_is_judged_by_a_stated_limit_and_its_error_has_its_remedy() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["sensorless by injection"] == "usable up to 2.35 A along MTPA if its angle error is compensated"
    assert rows["... as it is"].startswith("up to 660 mA along MTPA the angle error stays within the limit of 5°")
    assert rows["... error to compensate"].startswith(
        "up to 23.5° electrical, at (+0.400, +2.300) A: θ = θ_tracked + ½ atan2("
    )
    small = dict(figure_rows(a_report(injection_error_deg=0.3, injection_within_limit_a=2.35)))
    assert small["sensorless by injection"] == (
        "usable up to 2.35 A as it is: angle error 0.3° at most, within the limit of 5°"
    )
    assert "... error to compensate" not in small
    left = dict(figure_rows(a_report(injection_left_by_map_deg=7.0)))
    assert left["sensorless by injection"] == "usable up to 660 mA"


def test_injection_that_works_nearly_nowhere_is_not_usable_on_this_motor() -> None:
    rows = dict(figure_rows(a_report(injection_works_percent=1.7)))
    assert rows["sensorless by injection"].startswith("not usable on this motor: the saliency suffices at 1.7 % of")
    assert "... error to compensate" not in rows


def test_where_the_saliency_ends_is_stated_along_the_references() -> None:
    rows = dict(figure_rows(a_report(injection_works_percent=59.0, injection_fails_at_a=(-3.0, 4.0))))
    assert rows["sensorless by injection"].startswith("usable below 5 A along MTPA if its angle error is")
    assert rows["... beyond"].startswith("the saliency is too small")


def test_an_observer_has_no_speed_below_what_drift_allows() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["sensorless by back-EMF"].startswith("usable from 356 rpm on: angle error within 5°")
    assert rows["... if R_s follows the winding"] == "from 45 rpm on"
    row = dict(figure_rows(a_report(observer_speed_rpm=0.2)))["... if R_s follows the winding"]
    assert row == "from less than 18 rpm on, where drift and offsets decide; these are not counted"


def test_what_the_figures_rest_on_is_stated() -> None:
    rows = dict(figure_rows(a_report(nameplate_magnet_wb=0.3, r_s_temperature_is_assumed=True)))
    assert rows["R_s"].startswith("4.25 Ω a phase with the winding at 20 °C (assumed")
    assert rows["... by the magnet's flux"].startswith("300 mWb, copied from the nameplate, not from a measurement")
    rows = dict(figure_rows(a_report()))
    assert "assumed" not in rows["R_s"]
    assert "... by the magnet's flux" not in rows


def test_the_control_of_flux_and_the_gains_of_plain_controllers_stand_apart() -> None:
    more = {
        "k_p_v_per_a": (0.34, 0.5), "k_i_v_per_as": 253.0, "least_inductance_h": (1e-3, 2e-3),
        "least_inductance_at_a": ((2.0, 0.0), (0.0, 2.0)), "rest_inductance_h": (1e-3, 4e-3),
    }  # fmt: skip
    rows = dict(figure_rows(a_report(**more)))
    assert rows["flux control in the C code"].startswith("bandwidth 448 Hz at every current; phase margin at least 60°")
    assert rows["PI current control instead"].startswith("k_p = 2π 448 Hz · L and k_i = 2π 448 Hz · R_s")
    assert rows["... k_p of i_d"] == "0.34 V/A by L_d = 1 mH"
    assert rows["... k_p of i_q"] == (
        "0.5 V/A by L_q = 2 mH, the least, at (+0.000, +2.000) A; without current 4 mH, so 224 Hz"
    )


def test_the_part_of_the_loss_that_is_a_time_is_told_from_the_other() -> None:
    more = {"compensated": ("dead_time",), "lost_v": 1.19, "lost_time_s": 203e-9, "pwm_hz": 1e4}
    rows = dict(figure_rows(a_report(**more, lost_in_proportion_to_bus_v=0.8)))
    assert rows["inverter's loss"] == "1.19 V a leg at 2.35 A and 394 V bus"
    assert rows["... in proportion to the bus"] == "800 mV: effective dead time 203 ns at 10 kHz PWM"
    assert rows["... at any bus voltage"].startswith("390 mV: this is no dead time")
    alone = dict(figure_rows(a_report(**more, lost_in_proportion_to_bus_v=1.19)))
    assert alone["... in proportion to the bus"] == "all of it: effective dead time 203 ns at 10 kHz PWM"
    assert "... at any bus voltage" not in alone
    assert headline(a_report(**more, sampling_hz=2e4)).endswith("control at 20000 Hz, PWM at 10000 Hz")
    assert "PWM" not in headline(a_report(**more))


def test_each_file_has_its_content_beside_it() -> None:
    files = ("tuning.json", "torque.csv", "m_drive.h", "m_drive.c", "m_drive_int32.h", "m_drive_int32.c", "vesc.txt")
    rows = dict(file_rows(a_report(files=files)))
    assert list(rows) == ["tuning.json", "torque.csv", "m_drive.c", "m_drive_int32.c", "vesc.txt"]
    assert all(rows.values())
    assert "int32" in rows["m_drive_int32.c"]


def test_the_ripple_of_a_wave_is_what_its_fundamental_leaves() -> None:
    angle = 2.0 * math.pi * np.arange(360) / 360.0
    wave = 2.0 * np.cos(angle + 0.3) + 0.01 * np.cos(5.0 * angle)
    assert ripple_of(wave) == pytest.approx(0.01 * np.cos(5.0 * angle), abs=1e-12)


def test_what_is_compensated_in_part_is_not_listed_as_left_out() -> None:
    left = {"dead_time": "it is compensated in part: leg b's loss is larger", "bus_sag": "it is measured"}
    lines = notes(a_report(compensated=("dead_time",), left_out=left, remarks=()))
    assert lines == [
        "dead time: it is compensated in part: leg b's loss is larger", "not compensated: bus sag (it is measured)",
    ]  # fmt: skip
