"""R_s and its drift against what the recording was made with."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.estimation.usability import resistance_checks
from plugins.estimators.resistance import ResistanceEstimator
from protocols import CheckOutcome, EstimationContext, MapCriteria, SegmentStage
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.plant import R_S, Array
from tests.plugins.estimators.recordings import (
    PHASES,
    behind_dead_time,
    clean,
    resistance_of,
)


@pytest.mark.parametrize("inverter", [False, True], ids=["clean", "dead time"])
def test_resistance_and_its_interval_hold_the_truth(inverter: bool) -> None:
    found = resistance_of(behind_dead_time() if inverter else clean())
    assert found.value_ohm == pytest.approx(R_S, rel=2e-3)
    assert found.high - found.low < 0.05 * R_S
    assert found.low - 2e-3 < R_S < found.high + 2e-3
    assert len(found.readings) > 40
    assert found.last_ohm == pytest.approx(R_S, rel=5e-3)


def test_one_held_current_will_do_where_injection_tells_what_the_inverter_keeps() -> None:
    recording = behind_dead_time().only(SegmentStage.RESISTANCE, SegmentStage.INJECTION)
    holds = recording.segments(SegmentStage.RESISTANCE)
    largest = max(holds, key=lambda s: float(np.linalg.norm(recording.load(s).i_ab.mean(axis=0))))
    kept = [s for s in recording.manifest.segments if s.stage is SegmentStage.INJECTION or s == largest]
    found = resistance_of(recording.with_segments(tuple(kept)))
    assert found.value_ohm == pytest.approx(R_S, rel=0.01)
    assert found.low <= R_S <= found.high
    assert found.inverter[0].phase_v > 0.1
    assert not any(remark.code == "few_currents" for remark in found.remarks)


@pytest.mark.parametrize("classical", [False, True], ids=["one current", "sweeps between two currents"])
def test_where_the_inverter_cannot_be_reported_the_interval_holds_what_it_may_have_in_it(classical: bool) -> None:
    recording = behind_dead_time().only(SegmentStage.CLASSICAL if classical else SegmentStage.RESISTANCE)
    segments = recording.manifest.segments[:1] if classical else recording.manifest.segments[4:5]
    found = resistance_of(recording.with_segments(segments))
    assert found.value_ohm > 1.03 * R_S
    assert found.low < R_S < found.high
    few = next(remark for remark in found.remarks if remark.code == "few_currents")
    assert few.values["low_ohm"] == found.low


def test_what_was_measured_before_stands_where_the_inverter_cannot_be_reported() -> None:
    recording = behind_dead_time().only(SegmentStage.RESISTANCE)
    motor = recording.manifest.motor.model_copy(
        update={"stator_resistance_ohm": 1.005 * R_S, "stator_resistance_std_ohm": 0.01 * R_S}
    )
    manifest = recording.manifest.model_copy(update={"motor": motor, "segments": recording.manifest.segments[4:5]})
    found = resistance_of(MemoryRecording(manifest, recording.captures))
    assert found.value_ohm == pytest.approx(R_S, rel=0.01)
    assert found.low < R_S < found.high


def test_resistance_drift_is_read_off_the_sweeps() -> None:
    recording = clean().only(SegmentStage.RESISTANCE, SegmentStage.CLASSICAL)
    end = recording.manifest.segments[-1].start_s
    warmed = {
        s.id: (c := recording.load(s)).model_copy(update={"v_ab": c.v_ab + 0.1 * R_S * s.start_s / end * c.i_ab})
        for s in recording.manifest.segments
    }
    found = resistance_of(MemoryRecording(recording.manifest, warmed))
    assert found.first_ohm == pytest.approx(R_S, rel=0.01)
    assert found.last_ohm == pytest.approx(1.1 * R_S, rel=0.01)
    drift = next(remark for remark in found.remarks if remark.code == "drift")
    assert drift.values["rise_k"] == pytest.approx(25.0, abs=1.0)
    starts = [reading.start_s for reading in found.readings]
    assert starts == sorted(starts)


def test_the_value_is_the_mean_over_the_instants_that_it_is_reported_from() -> None:
    recording = clean()
    end = recording.manifest.segments[-1].start_s

    def ohm(time_s: Array) -> Array:
        return np.asarray(R_S * (1.0 + 0.2 * np.sqrt(time_s / end)))

    warmed = {}
    for segment in recording.manifest.segments:
        capture = recording.load(segment)
        time_s = capture.start_s + np.arange(len(capture)) / capture.sampling_frequency_hz
        extra = (ohm(time_s) - R_S)[:, None] * capture.i_ab
        warmed[segment.id] = capture.model_copy(update={"v_ab": capture.v_ab + extra})
    drifting = MemoryRecording(recording.manifest, warmed)
    found = resistance_of(drifting)
    truth = np.mean(
        [ohm(np.array(d.start_s + 0.5 * d.seconds)) for d in ResistanceEstimator().constant_currents(drifting)]
    )
    assert found.low < truth < found.high
    assert found.high - found.low < 0.02 * R_S


@pytest.mark.parametrize("known", [False, True], ids=["no inverter", "dead time"])
def test_injections_points_are_readings_too(known: bool) -> None:
    recording = behind_dead_time() if known else clean()
    start_s = min(segment.start_s for segment in recording.segments(SegmentStage.INJECTION))
    late = [reading for reading in resistance_of(recording).readings if reading.start_s > start_s]
    assert len(late) > 10
    assert all(abs(one.value_ohm - R_S) < max(4.0 * one.std_ohm, 5e-3 * R_S) for one in late)


def test_sweeps_alone_tell_a_resistance_too() -> None:
    found = resistance_of(clean().only(SegmentStage.CLASSICAL))
    assert found.value_ohm == pytest.approx(R_S, rel=5e-3)
    assert "no_holds" in {remark.code for remark in found.remarks}


def test_a_bridge_that_leaves_out_short_pulses_is_no_dead_time_and_the_interval_holds_the_truth() -> None:
    recording = clean().only(SegmentStage.RESISTANCE)

    def commanded(i_ab: Array) -> Array:
        needed = R_S * (i_ab @ PHASES.T)
        out: Array = (np.sign(needed) * np.maximum(np.abs(needed), 4.0)) @ (2 / 3 * PHASES)
        return out

    behind = {}
    for segment in recording.manifest.segments:
        capture = recording.load(segment)
        beside = capture.v_ab - R_S * capture.i_ab
        behind[segment.id] = capture.model_copy(update={"v_ab": commanded(capture.i_ab.mean(axis=0)[None]) + beside})
    found = ResistanceEstimator().estimate(MemoryRecording(recording.manifest, behind), EstimationContext())
    assert found.inverter == ()
    assert found.low < R_S < found.high
    assert any(remark.code == "unlike_inverter" for remark in found.remarks)
    assert not any(remark.code in ("inverter_loss", "few_currents") for remark in found.remarks)
    interval = next(
        check
        for check in resistance_checks(found, recording.manifest.motor, {SegmentStage.RESISTANCE}, MapCriteria())
        if check.name == "resistance_interval"
    )
    assert interval.outcome is CheckOutcome.FAILED
