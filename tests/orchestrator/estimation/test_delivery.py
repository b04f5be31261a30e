"""A model's map among the results: first where nothing speaks against it, and never twice."""

from __future__ import annotations

from pathlib import Path

import h5netcdf
import numpy as np
import pytest

from orchestrator.estimation import deliver_model, estimate_recording, load_estimates, load_flux_map
from protocols import (
    Basis,
    EstimationReport,
    Estimator,
    FluxMap,
    Motor,
    Remark,
    ResistanceEstimate,
    Segment,
    SegmentStage,
    Usability,
)
from tests.orchestrator.analysis.test_checks import exact_map
from tests.orchestrator.estimation.made_up import RECORDING, Resistance, Ripples, Sweeps, explained

REMARK = Remark(code="model.of_the_model", text="model: R_s is that of the whole model")
R_S = ResistanceEstimate(value_ohm=4.1, low=4.09, high=4.11, first_ohm=4.1, last_ohm=4.3, remarks=(REMARK,))
ALL: list[Estimator] = [Resistance(), Sweeps(), Ripples()]
MOTOR = RECORDING.manifest.motor
AGAINST = (Remark.of("unexplained", "the model leaves {left_percent:.2g} % unexplained", left_percent=3.0),)


def model_map(scale: float = 1.0) -> FluxMap:
    known = exact_map()
    return known.model_copy(update={"method": "model", "basis": Basis.ENERGY, "psi_d": scale * known.psi_d})


def deliver(where: Path, *against: Remark, scale: float = 1.0, motor: Motor | None = None) -> EstimationReport:
    manifest = RECORDING.manifest.model_copy(update={"motor": motor or MOTOR})
    return deliver_model(where, model_map(scale), R_S, against, manifest=manifest, title="saturated + dead_time")


def test_the_models_map_and_resistance_take_first_place(tmp_path: Path) -> None:
    own = estimate_recording(RECORDING, [Resistance(), Sweeps(), Ripples()], tmp_path, check_model=explained)
    report = deliver(tmp_path, scale=1.5)
    assert (report.method, report.usable) == ("model", True)
    assert list(report.maps) == ["model", *own.maps]
    assert report.resistance is not None
    assert own.resistance is not None
    assert report.resistance.value_ohm == R_S.value_ohm
    assert report.resistance.readings == own.resistance.readings
    assert report.crossings == own.crossings
    np.testing.assert_array_equal(load_flux_map(tmp_path / "results" / "flux_map.nc").psi_d, model_map(1.5).psi_d)
    assert load_flux_map(tmp_path / "results" / f"flux_map_{own.method}.nc").method == own.method
    assert load_estimates(tmp_path) == report


def test_what_speaks_against_the_model_speaks_against_every_map(tmp_path: Path) -> None:
    own = estimate_recording(RECORDING, [Resistance(), Sweeps()], tmp_path)
    report = deliver(tmp_path, *AGAINST)
    assert (report.method, report.usable, report.resistance) == (own.method, False, own.resistance)
    assert report.remarks[0].code == "unexplained"
    assert load_flux_map(tmp_path / "results" / "flux_map_model.nc").method == "model"


@pytest.mark.slow
def test_a_later_model_replaces_an_earlier_one_and_nothing_else(tmp_path: Path) -> None:
    own = estimate_recording(RECORDING, [Resistance(), Sweeps(), Ripples()], tmp_path, check_model=explained)
    once = deliver(tmp_path, scale=1.5)
    deliver(tmp_path, *AGAINST)
    again = deliver(tmp_path, scale=1.5)
    assert again.model_copy(update={"files": {}}) == once.model_copy(update={"files": {}})
    assert again.estimators is not None
    assert list(again.estimators.maps) == list(own.maps)
    files = {path.name for path in (tmp_path / "results").glob("flux_map*.nc")}
    assert files == {"flux_map.nc", *(f"flux_map_{method}.nc" for method in own.maps)}


def test_a_model_is_delivered_where_no_estimator_was_requested(tmp_path: Path) -> None:
    report = deliver(tmp_path)
    assert (report.method, report.usable, report.estimators) == ("model", True, None)
    assert {path.name for path in (tmp_path / "results").iterdir()} == {"flux_map.nc", "estimates.json"}
    assert deliver(tmp_path, scale=1.5).reasons == report.reasons


def test_a_new_pass_of_the_estimators_leaves_the_model_in_its_place(tmp_path: Path) -> None:
    estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    diagnosed = deliver(tmp_path)
    again = estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    assert again.model_dump() == diagnosed.model_dump()
    assert load_flux_map(tmp_path / "results" / "flux_map.nc").method == "model"


def test_a_new_pass_keeps_the_objections_to_the_model(tmp_path: Path) -> None:
    assert estimate_recording(RECORDING, ALL, tmp_path, check_model=explained).usable
    deliver(tmp_path, *AGAINST)
    again = estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    assert not again.usable
    assert again.remarks[0].code == "unexplained"


def test_a_model_of_other_segments_is_forgotten(tmp_path: Path) -> None:
    estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    deliver(tmp_path)
    longer = Segment(id="more", stage=SegmentStage.GATES_OFF, start_s=0.0, samples=1)
    manifest = RECORDING.manifest.model_copy(update={"segments": (longer,)})
    report = deliver_model(tmp_path, model_map(), R_S, (), manifest=manifest)
    assert report.method == "model"
    again = estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    assert again.method != "model"
    assert "is of other segments and left out" in "".join(again.reasons)
    assert not (tmp_path / "results" / "flux_map_model.nc").exists()
    assert "left out" not in "".join(deliver(tmp_path).reasons), "a new model takes its place"


def test_each_map_file_says_which_model_it_is_of(tmp_path: Path) -> None:
    own = estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    deliver(tmp_path)
    results = tmp_path / "results"
    with h5netcdf.File(results / "flux_map.nc", "r") as file:
        assert file.attrs["model"] == "fitted: saturated + dead_time"
    with h5netcdf.File(results / f"flux_map_{own.method}.nc", "r") as file:
        assert file.attrs["model"].startswith(f"estimator {own.method}")


@pytest.mark.parametrize(("times", "codes"), [(1.0, []), (1.38, ["far_from_nameplate"])])
def test_the_models_resistance_is_held_beside_the_nameplate(tmp_path: Path, times: float, codes: list[str]) -> None:
    plate = Motor.model_validate({**MOTOR.model_dump(), "stator_resistance_ohm": R_S.value_ohm / times})
    # What was stated of the estimators' own is not stated again.
    estimate_recording(RECORDING, [Resistance(), Sweeps(), Ripples()], tmp_path, check_model=explained)
    report = deliver(tmp_path, motor=plate)
    assert report.usable
    assert [r.code for r in report.remarks if r.code == "far_from_nameplate"] == codes


def test_earlier_results_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "estimates.json").write_text("{", encoding="utf-8")
    report = estimate_recording(RECORDING, ALL, tmp_path, check_model=explained)
    (text,) = (remark.text for remark in report.remarks if remark.code == "results_left_out")
    assert text.startswith("earlier results are left out: ")
    assert "estimates.json" in text
    (tmp_path / "results" / "estimates.json").write_text("{", encoding="utf-8")
    assert "results_left_out" in [remark.code for remark in deliver(tmp_path).remarks]


def test_without_a_model_no_map_is_judged_and_a_diagnosis_decides(tmp_path: Path) -> None:
    report = estimate_recording(RECORDING, ALL, tmp_path)
    assert (report.usable, report.usability) == (False, Usability.NOT_JUDGED)
    assert report.remarks[0].code == "not_judged"
    assert deliver(tmp_path).usability is Usability.USABLE
    assert deliver(tmp_path, *AGAINST).usability is Usability.NOT_USABLE
    assert "not_judged" not in [remark.code for remark in deliver(tmp_path, *AGAINST).remarks]
