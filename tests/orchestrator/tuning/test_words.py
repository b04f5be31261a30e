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
        "injection_left_by_map_deg": 0.295, "observer_speed_rpm": 45.0, "observer_speed_warm_rpm": 356.0,
    }  # fmt: skip
    return TuningReport.model_validate(fields | changed)


def test_a_torque_that_the_speed_limit_ends_is_told_from_one_that_the_voltage_ends() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["largest torque"].startswith("2.1 Nm at every speed up to the limit of 1800 rpm; the voltage")
    rows = dict(figure_rows(a_report(largest_speed_rpm=4000.0, torque_at_largest_speed_nm=1.58)))
    assert rows["largest torque"] == "2.1 Nm up to 3156 rpm; beyond, the voltage limits it"
    assert rows["... left at the largest speed"] == "1.58 Nm at 4000 rpm"


def test_position_errors_and_margins_name_their_speed_and_the_integral_part_its_limit() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["... position error"] == "at standstill up to 23.5° electrical, at (i_d, i_q) = (+0.400, +2.300) A"
    assert "at standstill up to 0.295°" in rows["... corrected by the map"]
    assert rows["... at the largest speed"] == "phase margin at least 58° at 1800 rpm"
    assert "its output is limited to 227 V" in rows["... its integral part"]


def test_an_observer_has_no_speed_below_what_drift_allows() -> None:
    rows = dict(figure_rows(a_report()))
    assert rows["back-EMF observer"].startswith("position error below 5° electrical from 356 rpm on")
    assert rows["... with R_s of the warm winding"] == "from 45 rpm on"
    row = dict(figure_rows(a_report(observer_speed_rpm=0.2)))["... with R_s of the warm winding"]
    assert row == "from less than 18 rpm on, where drift and offsets decide; these are not counted"


def test_gains_of_plain_controllers_and_the_time_that_a_leg_loses_are_stated() -> None:
    more = {"k_p_v_per_a": (0.34, 0.5), "k_i_v_per_as": 253.0, "lost_v": 0.3, "lost_time_s": 625e-9, "pwm_hz": 1e4}
    rows = dict(figure_rows(a_report(**more)))
    assert rows["... as plain PI controllers"] == "k_p 0.34 V/A for i_d, 0.5 V/A for i_q; k_i 253 V/(A s)"
    assert rows["inverter's loss"] == "up to 300 mV a leg; as a dead time 625 ns at 10 kHz PWM"
    assert headline(a_report(**more, sampling_hz=2e4)).endswith("control at 20000 Hz, PWM at 10000 Hz")
    assert "PWM" not in headline(a_report(**more))


def test_injection_that_works_nearly_nowhere_does_not_work_on_this_motor() -> None:
    rows = dict(figure_rows(a_report(injection_works_percent=1.7)))
    assert rows["tracking by injection"].startswith("does not work on this motor: the saliency suffices at 1.7 % of")
    assert "... position error" not in rows


def test_each_file_has_its_content_beside_it() -> None:
    files = ("tuning.json", "torque.csv", "m_drive.h", "m_drive.c", "m_drive_int32.h", "m_drive_int32.c", "vesc.txt")
    rows = dict(file_rows(a_report(files=files)))
    assert list(rows) == ["tuning.json", "torque.csv", "m_drive.c", "m_drive_int32.c", "vesc.txt"]
    assert all(rows.values())
    assert "int32" in rows["m_drive_int32.c"]


def test_where_tracking_fails_is_stated_along_the_references() -> None:
    part = {"injection_works_percent": 59.0}
    rows = dict(figure_rows(a_report(**part, injection_fails_at_a=(-3.0, 4.0))))
    assert "works below (i_d, i_q) = (−3.000, +4.000) A, 5 A" in rows["... along the references"]
    assert dict(figure_rows(a_report(**part)))["... along the references"].startswith("works at all of them")
    assert "... along the references" not in dict(figure_rows(a_report()))


def test_the_ripple_of_a_wave_is_what_its_fundamental_leaves() -> None:
    angle = 2.0 * math.pi * np.arange(360) / 360.0
    wave = 2.0 * np.cos(angle + 0.3) + 0.01 * np.cos(5.0 * angle)
    assert ripple_of(wave) == pytest.approx(0.01 * np.cos(5.0 * angle), abs=1e-12)


def test_what_is_compensated_in_part_is_not_listed_as_left_out() -> None:
    left = {"dead_time": "it is compensated in part: leg b's loss is larger", "bus_sag": "it is measured"}
    lines = notes(a_report(compensated=("dead_time",), left_out=left, remarks=()))
    assert lines == [
        "dead time: it is compensated in part: leg b's loss is larger", "not compensated: bus sag, it is measured",
    ]  # fmt: skip
