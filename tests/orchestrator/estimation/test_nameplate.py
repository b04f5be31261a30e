"""Estimates far from the nameplate are stated to be, and a scale of all of them is an objection."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording
from protocols import (
    AxisPercent,
    CheckOutcome,
    Estimate,
    EstimationContext,
    EstimationReport,
    Estimator,
    FluxMapEstimate,
    Motor,
    RecordingReader,
    ResistanceEstimate,
)
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.test_checks import exact_map
from tests.orchestrator.estimation.made_up import (
    R_S,
    RECORDING,
    SOUND,
    OneEnergy,
    Resistance,
    Ripples,
    Sweeps,
    explained,
)

EXACT = exact_map("ripples")
AT_REST = np.unravel_index(np.argmin(np.add.outer(EXACT.i_d**2, EXACT.i_q**2)), EXACT.l_dd.shape)


def report(folder: Path, **times: float) -> EstimationReport:
    """Of a motor whose nameplate is so many times what is estimated."""
    values = {
        "stator_resistance_ohm": R_S.value_ohm,
        "d_inductance_h": float(EXACT.l_dd[AT_REST]),
        "q_inductance_h": float(EXACT.l_qq[AT_REST]),
    }
    plate = {name: times[name] * value for name, value in values.items() if name in times}
    motor = Motor.model_validate({**RECORDING.manifest.motor.model_dump(), **plate})
    manifest = RECORDING.manifest.model_copy(update={"motor": motor})
    return estimate_recording(
        MemoryRecording(manifest, {}), [Resistance(), Sweeps(), Ripples()], folder, check_model=explained
    )


def far(found: EstimationReport) -> dict[str, float]:
    return {
        str(remark.values["name"]): float(remark.values["ratio"] or 0.0)
        for remark in found.remarks
        if remark.code == "far_from_nameplate"
    }


def test_what_is_near_the_nameplate_needs_no_word(tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=1.2, d_inductance_h=0.85, q_inductance_h=1.0)
    assert far(found) == {}
    assert found.usable


def test_what_is_a_fifth_off_stands_in_the_verdict_with_both_numbers(tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=0.8, d_inductance_h=1.0, q_inductance_h=1.0)
    assert far(found) == {"R_s": pytest.approx(1.25)}
    (stated,) = [remark.text for remark in found.remarks if remark.code == "far_from_nameplate"]
    assert f"{R_S.value_ohm:.4g} ohm, 1.25 times the nameplate's {0.8 * R_S.value_ohm:.4g} ohm" in stated


@pytest.mark.parametrize(
    ("plate", "words"),
    [
        (1.2247, "all 0.817 times the nameplate's: one scale of the currents or voltages explains it; 0.816 = √(2/3)"),
        (0.8165, "1.22 = √(3/2), as between power-invariant and amplitude-invariant values: is `scaling` right?"),
        (1.16, "all 0.862 times the nameplate's: one scale of the currents or voltages explains it"),
    ],
)
def test_one_factor_of_all_is_a_remark_that_names_its_convention(plate: float, words: str, tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=plate, d_inductance_h=plate, q_inductance_h=plate)
    (text,) = [remark.text for remark in found.remarks if remark.code == "common_factor"]
    assert words in text
    assert ("scaling" in text) == (abs(plate - 1.16) > 0.01)


def test_values_that_differ_from_the_nameplate_by_several_factors_have_no_common_one(tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=1.2247, d_inductance_h=1.0, q_inductance_h=1.2)
    assert "common_factor" not in {remark.code for remark in found.remarks}


def test_a_resistance_far_off_is_stated_and_the_map_may_be_used(tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=0.5, d_inductance_h=1.0, q_inductance_h=1.0)
    assert far(found) == {"R_s": pytest.approx(2.0)}
    assert found.usable


def test_all_off_the_same_way_is_a_scale_of_the_readings(tmp_path: Path) -> None:
    found = report(tmp_path, stator_resistance_ohm=0.5, d_inductance_h=0.5, q_inductance_h=0.5)
    assert set(far(found)) == {"R_s", "L_d", "L_q"}
    assert not found.usable
    failed = [check for check in found.checks if check.outcome is CheckOutcome.FAILED]
    assert [check.name for check in failed] == ["nameplate"]
    reason = failed[0].remark.text
    assert "either the nameplate is wrong, or the currents or voltages are scaled" in reason
    assert f"{2 * R_S.value_ohm:.3g} ohm if the readings are right, {R_S.value_ohm:.3g} ohm if the nameplate" in reason
    assert far(report(tmp_path, stator_resistance_ohm=0.5, d_inductance_h=2.0, q_inductance_h=2.0))
    assert report(tmp_path, stator_resistance_ohm=0.5, d_inductance_h=2.0, q_inductance_h=2.0).usable


def test_no_nameplate_is_no_remark(tmp_path: Path) -> None:
    assert far(report(tmp_path)) == {}


@pytest.mark.parametrize(("ratio", "usable"), [(0.3, True), (0.2, False), (30.0, False)])
def test_a_resistance_that_no_convention_makes_leaves_no_map_usable(ratio: float, usable: bool, tmp_path: Path) -> None:
    assert report(tmp_path, stator_resistance_ohm=ratio).usable is usable


class WrongRipples(Ripples):
    """Injection's map whose inductances dead time has made twice too large, and which is not reliable."""

    def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
        made = super().estimate(recording, context)
        assert isinstance(made, FluxMapEstimate)
        wrong = {"l_dd": 2.0 * made.map.l_dd, "l_qq": 2.0 * made.map.l_qq}
        return made.model_copy(update={"map": made.map.model_copy(update=wrong)})


class LesserEnergy(OneEnergy):
    rank: ClassVar[int] = 5
    requires: ClassVar[tuple[type[Estimate], ...]] = (ResistanceEstimate,)


@pytest.mark.parametrize(("reliable", "ratios"), [(True, {"L_d": 2.0, "L_q": 2.0}), (False, {})])
def test_a_nameplate_is_compared_with_the_corrected_map_where_injection_s_is_not_reliable(
    reliable: bool, ratios: dict[str, float], tmp_path: Path
) -> None:
    checks = SOUND if reliable else SOUND.model_copy(update={"parity": AxisPercent(d_percent=9.0, q_percent=9.0)})
    plate = {"d_inductance_h": float(EXACT.l_dd[AT_REST]), "q_inductance_h": float(EXACT.l_qq[AT_REST])}
    motor = Motor.model_validate({**RECORDING.manifest.motor.model_dump(), **plate})
    recording = MemoryRecording(RECORDING.manifest.model_copy(update={"motor": motor}), {})
    estimators: list[Estimator] = [Resistance(), Sweeps(), WrongRipples(checks=checks), LesserEnergy()]
    found = estimate_recording(recording, estimators, tmp_path, check_model=explained)
    assert (found.method, found.usable) == ("ripples", reliable)
    assert far(found) == pytest.approx(ratios)
