"""R and L beside the nameplate, where no set-point says which of the readings is off."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.conventions import find_convention
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
