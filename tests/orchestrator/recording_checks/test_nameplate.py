"""R and L beside the nameplate, where no set-point says which of the readings is off."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.recording_checks import find_convention
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.nameplate import against_nameplate
from orchestrator.recording_checks.responses import AtRest, Responses
from orchestrator.recording_checks.survey import survey
from tests.support.rewriting import Rewritten

SET_POINTS = ("current_d_a", "current_q_a", "target_d_a", "target_q_a", "amplitude_v")


@pytest.mark.parametrize("factor", [0.5, 10.0])
def test_without_set_points_a_scale_is_of_the_currents_or_the_voltages(right: Rewritten, factor: float) -> None:
    found = find_convention(right.mapped("i_ab", factor * np.eye(2)).without_settings(*SET_POINTS))
    assert found is not None
    assert found.kind == "scaled"
    assert f"currents look scaled by {factor:g}" in found.what
    assert f"voltages by {1 / factor:g}" in found.what


def test_a_nameplate_without_values_makes_no_convention(right: Rewritten) -> None:
    empty = {"stator_resistance_ohm": None, "d_inductance_h": None, "q_inductance_h": None}
    assert find_convention(right.plated(**empty)) is None
    assert find_convention(right.plated(**empty).without_settings(*SET_POINTS)) is None


def test_a_resistance_that_is_off_alone_is_no_scale(right: Rewritten) -> None:
    ohm = right.manifest.motor.stator_resistance_ohm
    assert ohm is not None
    assert find_convention(right.plated(stator_resistance_ohm=0.5 * ohm)) is None


@pytest.mark.parametrize(("loss_v", "resistive", "named"), [(0.0, 1.0, True), (10.0, 0.2, False)])
def test_a_resistance_beside_a_loss_that_is_most_of_the_voltage_is_held_against_no_nameplate(
    right: Rewritten, loss_v: float, resistive: float, named: bool
) -> None:
    """A machine of some milliohms behind a dead time: what is left of the voltage is not its R_s."""
    currents = 2.5 * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
    losses = loss_v * np.exp(1j * np.round(np.angle(currents) / (np.pi / 3.0)) * (np.pi / 3.0))
    seen = Responses(survey(right, ConventionCriteria()))
    seen.rest = AtRest(currents, 1.0 * currents + losses, whole_plane=True)
    seen.resistance_ohm, seen.resistance_ratio, seen.inductance_ratio = 1.0, 1.56, 1.32
    assert seen.resistive_part == pytest.approx(resistive, abs=0.05)
    assert (against_nameplate(seen) is not None) == named
