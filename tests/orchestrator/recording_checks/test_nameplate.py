"""R and L beside the nameplate: both hypotheses are named, and nothing is rescaled."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orchestrator.recording_checks import check_recording
from orchestrator.recording_checks.nameplate import nameplate_remarks
from orchestrator.recording_checks.responses import Responses, SteadyState, _exact_inductance
from orchestrator.recording_checks.survey import survey
from protocols import Remark
from tests.support.rewriting import Rewritten

SET_POINTS = ("current_d_a", "current_q_a", "target_d_a", "target_q_a", "amplitude_v")


def scaled(right: Rewritten, resistance: float, inductance: float) -> Rewritten:
    """The recording with a nameplate of so many times R and L."""
    motor = right.manifest.motor
    factors = {"stator_resistance_ohm": resistance, "d_inductance_h": inductance, "q_inductance_h": inductance}
    return right.plated(**{name: factor * getattr(motor, name) for name, factor in factors.items()})


def only_remark(recording: Rewritten) -> Remark:
    checked = check_recording(recording)
    assert checked.convention is None
    (remark,) = checked.remarks
    return remark


@pytest.mark.parametrize("factor", [0.5, 10.0])
def test_without_set_points_both_the_nameplate_and_the_readings_are_doubted(right: Rewritten, factor: float) -> None:
    remark = only_remark(right.mapped("i_ab", factor * np.eye(2)).without_settings(*SET_POINTS))
    assert remark.code == "nameplate_or_readings"
    assert "Either the nameplate is wrong" in remark.text
    assert f"currents scaled by {factor:g}" in remark.text
    assert f"voltages by {1 / factor:.3g}" in remark.text
    assert "No set-points were logged" in remark.text


@pytest.mark.parametrize("factor", [2.0 / 3.0, 0.1, 0.4, 1.5, 2.0, 10.0])
def test_a_nameplate_that_is_off_by_a_factor_is_no_convention_and_the_ohmmeter_decides(
    right: Rewritten, factor: float
) -> None:
    remark = only_remark(scaled(right, factor, factor))
    ohm = right.manifest.motor.stator_resistance_ohm
    assert ohm is not None
    assert remark.code == "nameplate_or_readings"
    assert remark.values["resistance_ratio"] == pytest.approx(1.0 / factor, rel=0.1)
    assert remark.values["nameplate_ohm"] == pytest.approx(2.0 * factor * ohm)
    assert remark.values["readings_ohm"] == pytest.approx(2.0 * ohm, rel=0.1)
    assert "agree with their set-points within" in remark.text


def test_a_nameplate_measured_between_two_wires_is_line_to_line(right: Rewritten) -> None:
    """davidmolony/MESC_Firmware issue 63 (https://github.com/davidmolony/MESC_Firmware/issues/63).

    "If you measure with RLC, you get phase to phase values since you are measuring on two wires of the motor. A
    division by 2 is needed to get the right value per phase."
    """
    assert "written would be values from line to line" in only_remark(scaled(right, 2.0, 2.0)).text


def test_currents_that_miss_their_set_points_and_the_nameplate_alike_are_a_convention(right: Rewritten) -> None:
    checked = check_recording(right.mapped("i_ab", np.sqrt(0.5) * np.eye(2)))
    assert checked.convention is not None
    assert checked.convention.correction.factor == pytest.approx(math.sqrt(2.0))


def test_factors_that_differ_are_no_scale_of_the_readings(right: Rewritten) -> None:
    remark = only_remark(scaled(right, 1.0, 10.0))
    assert remark.code == "nameplate_inconsistent"
    assert "one of the nameplate's values or the sampling frequency is wrong" in remark.text


@pytest.mark.parametrize("settings", [(), SET_POINTS])
def test_a_nameplate_without_values_makes_no_remark(right: Rewritten, settings: tuple[str, ...]) -> None:
    empty = {"stator_resistance_ohm": None, "d_inductance_h": None, "q_inductance_h": None}
    checked = check_recording(right.plated(**empty).without_settings(*settings))
    assert checked.convention is None
    assert checked.remarks == ()


@pytest.mark.parametrize(("resistance", "inductance"), [(1.0, 1.0), (0.7, 1.0), (1.0, 1.8)])
def test_what_heat_and_saturation_make_of_r_and_l_is_not_remarked(
    right: Rewritten, resistance: float, inductance: float
) -> None:
    assert check_recording(scaled(right, resistance, inductance)).all_remarks == ()


@pytest.mark.parametrize(("loss_v", "resistive", "remarks"), [(0.0, 1.0, 1), (10.0, 0.2, 0)])
def test_a_resistance_beside_a_loss_that_is_most_of_the_voltage_is_held_against_no_nameplate(
    right: Rewritten, loss_v: float, resistive: float, remarks: int
) -> None:
    """A machine of some milliohms behind a dead time: what is left of the voltage is not its R_s."""
    currents = 2.5 * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
    losses = loss_v * np.exp(1j * np.round(np.angle(currents) / (np.pi / 3.0)) * (np.pi / 3.0))
    seen = Responses(survey(right))
    seen.steady_state = SteadyState(currents, 1.0 * currents + losses, whole_plane=True)
    seen.resistance_ohm, seen.resistance_ratio, seen.inductance_ratio = 1.0, 1.56, 1.32
    assert seen.resistive_part == pytest.approx(resistive, abs=0.05)
    assert len(nameplate_remarks(seen)) == remarks


@pytest.mark.parametrize("periods_per_time_constant", [0.1, 1.2, 10.0])
def test_an_inductance_is_reported_where_the_current_settles_within_a_sample(periods_per_time_constant: float) -> None:
    ohm, rate_hz = 5.85, 20e3
    henry = ohm * periods_per_time_constant / rate_hz
    slope = (1.0 - math.exp(-ohm / (rate_hz * henry))) / ohm
    assert _exact_inductance(1.0 / (rate_hz * slope), ohm, rate_hz) == pytest.approx(henry)
