"""Runs are written as results of known maps, so that what changed is known to the last digit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis.reporting.diagnosis_file import save_diagnosis
from orchestrator.estimation.results import write_results
from orchestrator.interface.comparison import RunsComparison, compare_runs
from protocols import (
    DiagnosisWords,
    EstimationReport,
    FluxMap,
    FoundEffect,
    InputError,
    MapChecks,
    MapReport,
    ParameterValue,
    RecordingError,
    ResistanceEstimate,
)
from tests.orchestrator.flux_maps.exporting.machines import saturated_flux, saturated_map
from tests.plugins.streams.report.example_diagnosis import a_diagnosis
from tests.support.processes import called

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"
WORDS = DiagnosisWords(where_it_fails="", what_it_looks_like="", likely_cause="", if_added="", to_decide="")


def moved(slide_a: float = 0.0, gain: float = 1.0, std_wb: float = 3e-5) -> FluxMap:
    """The saturated machine with its magnet weaker by what slides the map, read by other sensors."""
    plain = saturated_map(nodes=25, reach_a=3.0)
    i = np.stack(np.meshgrid(plain.i_d + slide_a, plain.i_q, indexing="ij"), axis=-1)
    psi = gain * np.where(np.isfinite(plain.psi_d)[..., None], saturated_flux(i), np.nan)
    std = np.where(np.isfinite(plain.psi_d), std_wb, np.nan)
    return plain.model_copy(update={"psi_d": psi[..., 0], "psi_q": psi[..., 1], "psi_d_std": std, "psi_q_std": std})


def run(
    folder: Path, name: str, flux_map: FluxMap | None = None, r_s: float = 4.25, **effects: tuple[float, str]
) -> Path:
    """A recording with results; effects by name: size, and the effects indistinguishable from it."""
    path = folder / name
    path.mkdir()
    for one in ("recording.json", "captures"):
        (path / one).symlink_to(DATA / one)
    report = EstimationReport(
        resistance=ResistanceEstimate(value_ohm=r_s, low=r_s - 0.01, high=r_s + 0.01, first_ohm=r_s, last_ohm=r_s),
        method="energy",
        crossings=None,
        parity=None,
        reciprocity_percent=None,
        classical_against_injection_percent=None,
        usable=True,
        maps={"energy": MapReport(checks=MapChecks())},
    )
    write_results(report, {"energy": flux_map or moved()}, path / "results", motor="", recording=name)
    effects_of_run = tuple(
        FoundEffect(
            name=effect,
            parameters={"voltage_v": ParameterValue(value=size, low=size - 0.01, high=size + 0.01, unit="V")},
            twins=(twin,) if twin else (),
            relative_size=1.0,
            log_evidence=10.0,
        )
        for effect, (size, twin) in effects.items()
    )
    save_diagnosis(path, a_diagnosis(effects=effects_of_run, ladder=()), WORDS, ())
    return path


def codes(comparison: RunsComparison) -> list[str]:
    return [remark.code for remark in comparison.remarks]


def test_what_did_not_change_is_not_stated_to_have(tmp_path: Path) -> None:
    """Noise of the stated size is no change, in numbers nor in the map."""
    other = moved()
    noisy = other.model_copy(update={"psi_d": other.psi_d + np.random.default_rng(3).normal(0.0, 3e-5, (25, 25))})
    comparison = compare_runs([run(tmp_path, "a"), run(tmp_path, "b", noisy, r_s=4.26)]).comparison
    assert codes(comparison) == ["nothing_changed"]
    assert comparison.maps[0].changed is False
    assert {quantity.changed[1] for quantity in comparison.quantities} <= {False, None}


def test_a_warmer_winding_is_reported_in_kelvin(tmp_path: Path) -> None:
    comparison = compare_runs([run(tmp_path, "cold"), run(tmp_path, "hot", r_s=4.25 * (1 + 0.00393 * 30.0))]).comparison
    assert codes(comparison) == ["changed", "r_s_changed"]
    assert comparison.remarks[1].values["kelvin"] == pytest.approx(30.0)


def test_runs_that_are_called_alike_are_separated_by_where_they_are(tmp_path: Path) -> None:
    for where in ("one", "two"):
        (tmp_path / where).mkdir()
    comparison = compare_runs([run(tmp_path / "one", "rec"), run(tmp_path / "two", "rec", r_s=5.0)]).comparison
    assert [of.name for of in comparison.runs] == ["one/rec", "two/rec"]
    assert {remark.values["run"] for remark in comparison.remarks} == {"two/rec"}


def test_another_motor_is_not_the_same_one_warmed(tmp_path: Path) -> None:
    other = run(tmp_path, "b", r_s=0.4)
    manifest = json.loads((other / "recording.json").read_text())
    (other / "recording.json").unlink()
    manifest["motor"]["name"] = "another"
    (other / "recording.json").write_text(json.dumps(manifest))
    assert codes(compare_runs([run(tmp_path, "a"), other]).comparison) == ["other_motors", "changed"]


def test_a_weaker_magnet_is_a_slide_and_a_sensor_is_a_gain(tmp_path: Path) -> None:
    result = compare_runs([run(tmp_path, "a"), run(tmp_path, "b", moved(0.05)), run(tmp_path, "c", moved(gain=1.01))])
    slid, grown = result.comparison.maps
    assert slid.changed
    assert grown.changed
    assert slid.slide_a == pytest.approx(0.05, rel=0.02)
    assert slid.gain_percent == pytest.approx(0.0, abs=0.02)
    assert grown.gain_percent == pytest.approx(1.0, rel=0.01)
    assert grown.slide_a == pytest.approx(0.0, abs=1e-3)
    assert (slid.left_percent or 1.0) < 0.02 * (slid.rms_percent or 0.0)
    assert np.nanmax(np.abs(result.flux_change(1))) == pytest.approx(7e-4, rel=0.05)


def test_effects_that_a_run_cannot_tell_apart_are_one_and_others_come_and_go(tmp_path: Path) -> None:
    first = run(tmp_path, "a", dead_time=(0.8, "device_drop"), bus_sag=(0.5, ""))
    other = run(tmp_path, "b", device_drop=(0.805, ""), voltage_bias=(0.1, ""))
    comparison = compare_runs([first, other]).comparison
    changed = {quantity.name: quantity.changed[1] for quantity in comparison.effects}
    assert changed == {
        "dead time or device drop: voltage": False,
        "bus sag: voltage": True,
        "voltage bias: voltage": True,
    }


def test_sizes_are_compared_whatever_else_a_diagnosis_has_of_them_or_older_ones_had_not(tmp_path: Path) -> None:
    first, older = (run(tmp_path, name, dead_time=(0.8, "")) for name in ("a", "b"))
    first_file, older_file = (path / "results" / "diagnosis.json" for path in (first, older))
    content = json.loads(first_file.read_text())
    companion = {"effect": "device_drop", "parameter": "voltage_v"}
    content["report"]["effects"][0]["parameters"]["voltage_v"].update(determined_with=companion, of_tomorrow=1)
    first_file.write_text(json.dumps(content))
    content = json.loads(older_file.read_text())
    for added in ("determined_with", "bends_form"):
        content["report"]["effects"][0]["parameters"]["voltage_v"].pop(added)
    older_file.write_text(json.dumps(content))
    (size,) = compare_runs([first, older]).comparison.effects
    assert [one and (one.value, one.unit) for one in size.values] == [(0.8, "V"), (0.8, "V")]


def test_runs_without_errors_of_their_maps_are_not_judged(tmp_path: Path) -> None:
    comparison = compare_runs([run(tmp_path, "a"), run(tmp_path, "b", moved(std_wb=np.nan))]).comparison
    assert comparison.maps[0].changed is None
    assert "map_unsure" in codes(comparison)


def test_one_run_alone_or_one_that_was_not_estimated_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two runs or more"):
        compare_runs([DATA])
    with pytest.raises(RecordingError, match="fluxbench estimate"):
        compare_runs([DATA, run(tmp_path, "a")])


def test_the_command_prints_the_page_holds_and_the_viewer_gets_what_changed(tmp_path: Path) -> None:
    paths = [run(tmp_path, "before"), run(tmp_path, "after", moved(0.05), dead_time=(0.8, ""))]
    comparison = json.loads(called("compare", *paths, "--json").stdout)
    assert [one["name"] for one in comparison["runs"]] == ["before", "after"]
    assert "changed beyond noise: the map" in called("compare", *paths).stdout
    done = called("compare", *paths, "--model", "linear")
    assert done.returncode == 2
    assert "a single recording" in done.stderr
    page = tmp_path / "page.html"
    assert called("report", *paths, "--out", page).returncode == 0
    assert "after minus before" in page.read_text()
    assert page.read_text().count("data:image/svg+xml") == 3
