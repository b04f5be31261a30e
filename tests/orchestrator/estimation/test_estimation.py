"""The pass over a recording, with estimators that are made up."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording
from protocols import (
    AxisPercent,
    Estimate,
    EstimationContext,
    EstimationReport,
    MapChecks,
    NotMeasuredError,
    PluginError,
    RecordingReader,
    ResistanceEstimate,
    SegmentStage,
)
from tests.orchestrator.estimation.made_up import R_S, RECORDING, Mapper, Resistance, Ripples, Sweeps, Swept, explained


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for v in value.values() for n in numbers(v)]
    if isinstance(value, list):
        return [n for v in value for n in numbers(v)]
    return [value] if isinstance(value, float) else []


def test_resistance_comes_first_and_the_rest_sees_it(tmp_path: Path) -> None:
    mapper, received = Sweeps(), list[Estimate]()
    estimate_recording(RECORDING, [mapper, Resistance()], tmp_path, on_estimate=received.append)
    assert mapper.saw is not None
    assert mapper.saw.resistance is R_S
    assert [type(estimate) for estimate in received] == [ResistanceEstimate, Swept]


def test_an_estimator_of_rare_stages_is_requested_only_where_there_is_one(tmp_path: Path) -> None:
    class Rare(Sweeps):
        reads: ClassVar[tuple[SegmentStage, ...]] = (SegmentStage.SPIN,)

    rare = Rare()
    report = estimate_recording(RECORDING, [rare, Resistance()], tmp_path)
    assert rare.saw is None
    assert all(remark.code != "not_measured" for remark in report.remarks)


def test_injection_is_recommended_and_every_map_has_its_file(tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, [Mapper("other"), Sweeps(), Ripples()], tmp_path, check_model=explained)
    assert report.method == "ripples"
    names = {path.name for path in (tmp_path / "results").iterdir()}
    assert names == {"flux_map.nc", "flux_map_sweeps.nc", "flux_map_other.nc", "estimates.json"}
    assert {Path(path).name for path in report.files.values()} == names
    assert report.classical_against_injection_percent == pytest.approx(0.0, abs=1e-9)


def test_the_file_is_the_report_and_all_its_numbers_are_finite(tmp_path: Path) -> None:
    percent = AxisPercent(d_percent=1.0, q_percent=None)
    checks = MapChecks(crossings=percent, parity=percent, reciprocity_percent=0.5)
    report = estimate_recording(RECORDING, [Resistance(), Sweeps(checks=checks)], tmp_path, check_model=explained)
    text = (tmp_path / "results" / "estimates.json").read_text()
    assert EstimationReport.model_validate_json(text) == report
    written = json.loads(text, parse_constant=lambda constant: pytest.fail(constant))
    assert all(math.isfinite(n) for n in numbers(written))
    reported = written["resistance"]
    assert {key: reported[key] for key in ("value_ohm", "low", "high", "first_ohm", "last_ohm")} == {
        "value_ohm": 4.0,
        "low": 3.9,
        "high": 4.1,
        "first_ohm": 4.0,
        "last_ohm": 4.2,
    }
    assert reported["readings"] == [
        {"start_s": 1.0, "value_ohm": 4.0, "std_ohm": 0.01},
        {"start_s": 9.0, "value_ohm": 4.2, "std_ohm": 0.01},
    ]
    assert written["classical_against_injection_percent"] is None
    assert written["usable"] is True


def test_what_could_not_be_measured_is_a_reason(tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, [Ripples(missing=True), Sweeps()], tmp_path, check_model=explained)
    assert report.method == "sweeps"
    assert report.usable
    assert any("no ripples here" in reason for reason in report.reasons)


def test_nothing_at_all_is_one_clear_line_and_no_file(tmp_path: Path) -> None:
    with pytest.raises(NotMeasuredError, match=r"made up: nothing can be estimated: .*no ripples here") as reported:
        estimate_recording(RECORDING, [Ripples(missing=True)], tmp_path)
    assert "\n" not in str(reported.value)
    assert list(tmp_path.iterdir()) == []


def test_equations_without_a_solution_are_one_clear_line(tmp_path: Path) -> None:
    class Singular(Sweeps):
        name: ClassVar[str] = "singular"

        def estimate(self, recording: RecordingReader, context: EstimationContext) -> Estimate:
            np.linalg.inv(np.zeros((2, 2)))
            return super().estimate(recording, context)

    with pytest.raises(NotMeasuredError, match="do not determine the equations") as reported:
        estimate_recording(RECORDING, [Singular()], tmp_path)
    assert "\n" not in str(reported.value)
    assert reported.value.exit_code == 2
    report = estimate_recording(RECORDING, [Singular(), Ripples()], tmp_path, check_model=explained)
    assert report.method == "ripples"
    assert "singular.no_solution" in {remark.code for remark in report.remarks}


def test_an_estimator_that_returns_something_else_is_named(tmp_path: Path) -> None:
    class Wrong(Resistance):
        name: ClassVar[str] = "wrong"

        def estimate(self, recording: RecordingReader, context: EstimationContext) -> Any:
            return 4.0

    with pytest.raises(PluginError, match="wrong"):
        estimate_recording(RECORDING, [Wrong()], tmp_path)


def test_estimators_see_what_they_require_in_whatever_order_they_come(tmp_path: Path) -> None:
    ripples = Ripples()
    estimate_recording(RECORDING, [ripples, Sweeps(), Resistance()], tmp_path)
    assert ripples.saw is not None
    assert ripples.saw.latest(Swept) is not None
    assert ripples.saw.resistance is R_S
