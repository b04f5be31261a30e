"""The diagnosis finds what a machine on paper suffers from, and names nothing that it does not."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis import (
    Diagnosis,
    add_effects,
    compare_recording,
    diagnose_recording,
    in_words,
    judge,
    remove_effect,
)
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.recording import Recording, SegmentWriter, open_recording, read_model, write_manifest
from orchestrator.stages import parse_stage
from plugins.effects.frame import BrakeCompliance, RotorMisalignment
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis, SlotHarmonics
from plugins.effects.resistance import PhaseResistanceImbalance, ResistanceWithTemperature, WindingHeating
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset, CurrentOffsetDrift, ThirdCurrentSensor
from plugins.effects.timing import VoltageDelay
from protocols import (
    Capture,
    DiagnosisReport,
    DiagnosisStep,
    Effect,
    Judgement,
    NotMeasuredError,
    PluginError,
    Segment,
    SegmentStage,
    VerdictRecord,
)

LIBRARY: list[Effect] = [
    DeadTime(),
    DeviceDrop(),
    VoltageBias(),
    VoltageDelay(),
    CurrentGainMismatch(),
    CurrentOffset(),
    WindingHeating(),
    RotorMisalignment(),
    BrakeCompliance(),
    EddyCurrents(),
    Hysteresis(),
]
REPORT = {
    "recording", "noise_floor", "verdict", "effects", "traces", "joint", "ladder", "unexplained", "convention",
    "next_experiment", "remarks", "notes", "seconds", "criteria", "minor", "materiality",
    "reproduces_current_percent", "map_error_percent", "reasons", "verdict_record", "search",
}  # fmt: skip


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [n for v in value.values() for n in _numbers(v)]
    if isinstance(value, list):
        return [n for v in value for n in _numbers(v)]
    return [float(value)] if isinstance(value, int | float) else []


def _without_times(report: DiagnosisReport) -> DiagnosisReport:
    search = [event.model_copy(update={"seconds": 0.0}) for event in report.search]
    return report.model_copy(update={"seconds": 0.0, "search": search})


def _judged_again(report: DiagnosisReport) -> Judgement:
    """The verdict of a report that was written and read, by its record alone."""
    record = json.loads(report.model_dump_json())["verdict_record"]
    return judge(VerdictRecord.model_validate(record))


def _digest(recording: Recording) -> str:
    files = [*sorted(recording.path.glob("captures/*")), recording.path / "recording.json"]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()


@pytest.fixture(scope="module")
def steps() -> list[DiagnosisStep]:
    """What was shown of the diagnosis while it was at work."""
    return []


@pytest.fixture(scope="module")
def diagnosed(
    with_dead_time: Recording, steps: list[DiagnosisStep], tmp_path_factory: pytest.TempPathFactory
) -> Diagnosis:
    out = tmp_path_factory.mktemp("dead-time")
    return diagnose_recording(with_dead_time, LIBRARY, out=out, on_step=steps.append, propose=next_experiment)


@pytest.mark.slow
def test_a_zero_that_wanders_a_little_is_noise_of_a_size_that_is_stated(wandering: Recording, tmp_path: Path) -> None:
    diagnosis = diagnose_recording(wandering, LIBRARY, out=tmp_path)
    report = diagnosis.report
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["rotor_misalignment"]
    assert report.ladder[-1].chi2 == pytest.approx(1.0, abs=0.08)
    (stated,) = [r for r in report.remarks if r.code == "offset_scatter"]
    assert stated.values["scatter_ma"] == pytest.approx(2.0, rel=0.3)
    # The model that is kept knows of it: a comparison finds what the diagnosis left.
    assert compare_recording(wandering, LIBRARY, out=tmp_path).chi2 == pytest.approx(1.0, abs=0.08)


@pytest.mark.slow
def test_what_is_taken_out_and_added_again_keeps_the_noise_that_was_found(wandering: Recording, tmp_path: Path) -> None:
    diagnose_recording(wandering, LIBRARY, out=tmp_path)
    without = remove_effect(wandering, "rotor_misalignment", LIBRARY, out=tmp_path).ladder[-1].chi2
    assert without is not None
    assert without > 10.0
    assert add_effects(wandering, ["rotor_misalignment"], LIBRARY, out=tmp_path).ladder[-1].chi2 == pytest.approx(
        1.0, abs=0.08
    )


def test_clean_recording_is_clean(clean: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(clean, LIBRARY, out=tmp_path).report
    assert report.verdict == "clean"
    assert _judged_again(report) == Judgement(verdict="clean", reasons=report.reasons)
    assert not report.effects
    assert report.ladder[0].chi2 == pytest.approx(1.0, abs=0.05)
    assert report.ladder[0].rms_v == pytest.approx(report.noise_floor.rms_v, rel=0.05)


def test_dead_time_is_named_with_its_twin_and_its_size(diagnosed: Diagnosis) -> None:
    report = diagnosed.report
    assert report.verdict == "explained"
    (effect,) = report.effects
    # With one PWM frequency only nothing can tell the two apart.
    assert {effect.name, *effect.twins} == {"dead_time", "device_drop"}
    assert effect.parameters["voltage_v"].value == pytest.approx(0.8, rel=0.01)
    assert diagnosed.search.fit.model.r_s == pytest.approx(4.31, abs=0.005)


def test_the_verdict_follows_from_the_record_in_the_report(diagnosed: Diagnosis) -> None:
    report = diagnosed.report
    assert _judged_again(report) == Judgement(verdict="explained", reasons=report.reasons)
    assert report.reasons[0].quantity == "chi2_per_dof"
    assert report.reasons[0].value == report.ladder[-1].chi2


def test_the_search_is_kept_from_the_baseline_to_the_last_move(diagnosed: Diagnosis) -> None:
    search = diagnosed.report.search
    assert [event.step for event in search] == list(range(1, len(search) + 1))
    assert search[0].move == "baseline"
    assert search[0].chi2_after == diagnosed.report.ladder[0].chi2
    (cause,) = diagnosed.report.effects
    added = [event for event in search if event.move == "add" and event.decision == "accepted"]
    assert [event.effects for event in added] == [(cause.name,)]
    assert added[0].score == cause.log_evidence
    tried = [event.effects for event in search if event.move == "refit" and event.step < added[0].step]
    assert {("dead_time",), ("device_drop",)} <= set(tried)
    spent = [event.evaluations for event in search]
    assert spent == sorted(spent)
    assert spent[-1] > 0.0


def test_error_falls_to_the_noise(diagnosed: Diagnosis) -> None:
    first, last = diagnosed.report.ladder[0], diagnosed.report.ladder[-1]
    floor = diagnosed.report.noise_floor.heldout_rms_v
    assert first.heldout_rms_v is not None
    assert last.heldout_rms_v is not None
    assert floor is not None
    assert first.heldout_rms_v > 20 * floor
    assert last.heldout_rms_v < 1.15 * floor
    assert last.current_rms_a == pytest.approx(0.0045, rel=0.15)


@pytest.mark.slow
def test_two_workers_come_to_the_same_report(diagnosed: Diagnosis, with_dead_time: Recording, tmp_path: Path) -> None:
    found = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path, propose=next_experiment, workers=2)
    assert _without_times(found.report) == _without_times(diagnosed.report)


def test_each_rung_is_shown_in_order(diagnosed: Diagnosis, steps: list[DiagnosisStep]) -> None:
    ladder = diagnosed.report.ladder
    assert [s.index for s in steps] == list(range(len(ladder)))
    assert [s.added for s in steps] == [r.added for r in ladder]
    assert [s.chi2 for s in steps] == [r.chi2 for r in ladder]


def test_next_experiment_is_a_stage_of_a_procedure(diagnosed: Diagnosis) -> None:
    proposal = diagnosed.report.next_experiment
    assert proposal is not None
    stage = parse_stage(proposal.stage, "proposal", "stage")
    assert stage.name == "resistance"
    assert set(proposal.separates) == {"dead_time", "device_drop"}


def test_report_is_the_contract_and_all_its_numbers_are_finite(diagnosed: Diagnosis) -> None:
    report = json.loads(diagnosed.report.model_dump_json())
    assert set(report) == REPORT
    assert all(math.isfinite(number) for number in _numbers(report))
    assert set(report["ladder"][0]) == {"added", "effects", "chi2", "rms_v", "heldout_rms_v", "current_rms_a"}


def test_a_cause_has_its_share_its_probability_and_counts(diagnosed: Diagnosis) -> None:
    (cause,) = diagnosed.report.effects
    assert cause.material
    assert cause.probability == pytest.approx(1.0)
    assert cause.share == pytest.approx(1.0, rel=0.2)
    assert 0.0 < (diagnosed.report.reproduces_current_percent or 0.0) < 1.0
    assert 0.0 < (diagnosed.report.map_error_percent or 0.0) < 1.0


def test_words_name_cause_size_and_what_to_do(diagnosed: Diagnosis) -> None:
    words = in_words(diagnosed)
    assert "(voltage 8" in words.likely_cause
    assert "mV" in words.where_it_fails
    assert "resistance stage" in words.to_decide


@pytest.mark.slow
def test_misalignment_has_the_sign_true_minus_believed(misaligned: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(misaligned, LIBRARY, out=tmp_path).report
    assert [e.name for e in report.effects] == ["rotor_misalignment"]
    angle = report.effects[0].parameters["angle_rad"]
    assert angle.value == pytest.approx(-0.03, abs=0.0005)
    assert angle.low is not None
    assert angle.high is not None
    assert angle.low < -0.03 < angle.high


@pytest.mark.slow
def test_foreign_effect_gets_no_name(drifting: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(drifting, LIBRARY, out=tmp_path).report
    assert report.verdict == "unknown_remains"
    assert not report.effects
    assert report.unexplained.shape[0].group == "constant"


@pytest.mark.slow
def test_a_drift_that_is_in_the_library_is_named(drifting: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(drifting, [*LIBRARY, CurrentOffsetDrift()], out=tmp_path).report
    assert [e.name for e in report.effects] == ["current_offset_drift"]
    assert report.effects[0].parameters["rate_a_a_per_s"].value == pytest.approx(0.004, rel=0.02)


@pytest.mark.slow
def test_a_third_sensor_that_reads_more_is_named_and_nothing_beside_it(
    of_three_sensors: Recording, tmp_path: Path
) -> None:
    library = [*LIBRARY, ThirdCurrentSensor(), PhaseResistanceImbalance(), SlotHarmonics()]
    report = diagnose_recording(of_three_sensors, library, out=tmp_path).report
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["third_current_sensor"]
    assert report.effects[0].parameters["gain_c_minus_1"].value == pytest.approx(0.01, rel=0.02)
    (sum_,) = (remark for remark in report.remarks if remark.code == "gains_by_sum")
    assert sum_.values["c_percent"] == pytest.approx(0.667, rel=0.02)


@pytest.mark.slow
def test_gains_that_three_readings_prove_are_not_reported_as_a_resistance(
    first_of_three_sensors: Recording, tmp_path: Path
) -> None:
    """Phase a lies on the d axis, where the map would take its gain."""
    library = [*LIBRARY, ThirdCurrentSensor(), PhaseResistanceImbalance(), SlotHarmonics()]
    report = diagnose_recording(first_of_three_sensors, library, out=tmp_path).report
    assert report.verdict == "explained"
    found = {e.name: next(iter(e.parameters.values())).value for e in report.effects}
    # Beside the mean of the other two, c reads half of a's excess less.
    assert found == pytest.approx({"current_gain_mismatch": 0.01, "third_current_sensor": -0.005}, rel=0.02)


@pytest.mark.slow
def test_a_resistance_that_goes_with_the_logged_temperature_is_named(
    with_thermometer: Recording, tmp_path: Path
) -> None:
    report = diagnose_recording(with_thermometer, [*LIBRARY, ResistanceWithTemperature()], out=tmp_path).report
    assert report.verdict == "explained"
    assert [e.name for e in report.effects] == ["resistance_with_temperature"]
    assert report.effects[0].parameters["per_k"].value == pytest.approx(0.0035, rel=0.02)


def test_what_cannot_show_is_not_looked_for(clean: Recording, tmp_path: Path) -> None:
    diagnosis = diagnose_recording(clean, [DeadTime(), ResistanceWithTemperature()], out=tmp_path)
    assert [c.name for c in diagnosis.library] == ["dead_time"]


@pytest.mark.slow
def test_effect_taken_out_of_the_library_leaves_something_unknown(misaligned: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(misaligned, LIBRARY, without=["rotor_misalignment"], out=tmp_path).report
    assert report.verdict == "unknown_remains"


@pytest.mark.slow
def test_ladder_climbs_from_the_nameplate(misaligned: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(misaligned, LIBRARY, model="linear", out=tmp_path).report
    assert [r.added for r in report.ladder] == [None, "saturation", "cross_saturation", "rotor_misalignment"]
    errors = [r.rms_v for r in report.ladder]
    assert errors == sorted(errors, key=lambda e: -(e or 0.0))


@pytest.mark.slow
def test_effects_are_added_and_removed_by_name(misaligned: Recording, tmp_path: Path) -> None:
    before = _digest(misaligned)
    added = add_effects(misaligned, ["rotor_misalignment"], LIBRARY, out=tmp_path)
    assert [r.added for r in added.ladder] == [None, "rotor_misalignment"]
    assert (added.ladder[1].chi2 or 99.0) < 1.05
    kept = read_model(tmp_path)
    assert [e.name for e in kept.effects] == ["rotor_misalignment"]
    removed = remove_effect(misaligned, "rotor_misalignment", LIBRARY, out=tmp_path)
    assert not removed.effects
    assert removed.ladder[-1].chi2 == pytest.approx(added.ladder[0].chi2, rel=1e-6)
    assert _digest(misaligned) == before


def test_unknown_name_is_refused_with_the_nearest_one(clean: Recording, tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="dead_time"):
        add_effects(clean, ["dead_tim"], LIBRARY, out=tmp_path)


def test_recording_without_current_is_refused(clean: Recording, tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.004, (2000, 2))
    directory = tmp_path / "still"
    directory.mkdir()
    with SegmentWriter(directory, "resistance-000") as writer:
        capture = Capture(
            start_s=0.0, sampling_frequency_hz=1e4, i_ab=noise, v_ab=np.zeros((2000, 2)), v_dc=np.full(2000, 540.0)
        )
        writer.append(capture)
        written = writer.finish()
    segment = Segment(id="resistance-000", stage=SegmentStage.RESISTANCE, start_s=0.0, samples=written.samples)
    write_manifest(directory, clean.manifest.model_copy(update={"segments": (segment,)}))
    with pytest.raises(NotMeasuredError, match="no excitation"):
        diagnose_recording(open_recording(directory), LIBRARY, out=tmp_path)
