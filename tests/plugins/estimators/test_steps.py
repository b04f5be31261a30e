"""Maps by voltage steps, on a plant that shares nothing with the estimator; the truth is the plant's own table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.recording import open_recording
from plugins.estimators._maps import SteppedFlux
from plugins.estimators.steps import StepResistanceEstimator, StepsEstimator
from protocols import (
    Capture,
    DriveRecord,
    EstimationContext,
    FluxMap,
    Manifest,
    Motor,
    NotMeasuredError,
    RecordingReader,
    Segment,
    SegmentStage,
)
from tests.blind.campaign import Bench
from tests.blind.hidden import draw_case
from tests.blind.stepping import Steps, record_steps, usual
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.support.cases import few


def bench(number: int = 1, **plant: Any) -> Bench:
    drawn = draw_case("clean", number, 7).bench
    return replace(drawn, plant=drawn.plant._replace(**plant))


def recorded(at: Bench, folder: Path, volts: float = 60.0, seconds: float = 0.08) -> RecordingReader:
    """The usual steps; the nameplate's R_s is the plant's own."""
    known = replace(at.machine, resistance_ohm=at.plant.resistance)
    record_steps(replace(at, machine=known), usual(at, volts, seconds), folder / "steps")
    return open_recording(folder / "steps")


def believing(recording: RecordingReader, ohm: float | None, std: float | None) -> MemoryRecording:
    motor = recording.manifest.motor.model_copy(update={"stator_resistance_ohm": ohm, "stator_resistance_std_ohm": std})
    captures = {segment.id: recording.load(segment) for segment in recording.segments()}
    return MemoryRecording(recording.manifest.model_copy(update={"motor": motor}), captures)


def found(recording: RecordingReader) -> SteppedFlux:
    return StepsEstimator().estimate(recording, EstimationContext())


def errors(flux_map: FluxMap, at: Bench) -> tuple[np.ndarray, np.ndarray]:
    """Flux errors and stated deviations within three quarters of the currents, (n, 2) each, % of the rated flux."""
    places = [(a, b) for a in range(len(flux_map.i_d)) for b in range(len(flux_map.i_q))]
    currents = np.array([(flux_map.i_d[a], flux_map.i_q[b]) for a, b in places], dtype=np.float64)
    psi = np.array([(flux_map.psi_d[k], flux_map.psi_q[k]) for k in places]) - [at.machine.pm_flux_wb, 0.0]
    std = np.array([(flux_map.psi_d_std[k], flux_map.psi_q_std[k]) for k in places])
    known = np.isfinite(psi).all(axis=1) & (np.abs(currents).max(axis=1) < 0.75 * at.machine.top_a)
    zero = np.array(at.table.flux(0.0, 0.0))
    truth = np.array([at.table.flux(*current) for current in currents[known]]) - zero
    rated = np.linalg.norm(np.array(at.table.flux(0.0, at.machine.rated_current_rms_a * 2**0.5)) - zero)
    return 100.0 / rated * (psi[known] - truth), 100.0 / rated * std[known]


def rms(off: np.ndarray) -> float:
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@few("off", [0.0, 0.01], ids=["R known", "R off by 1 %"])
def test_the_map_is_right_to_a_thousandth_and_the_loops_tell_the_resistance(off: float, tmp_path: Path) -> None:
    at = bench()
    ohm = at.plant.resistance
    recording = believing(recorded(at, tmp_path), (1.0 + off) * ohm, 0.01 * ohm)
    stepped = found(recording)
    wrong, std = errors(stepped.map, at)
    assert rms(wrong) < 0.1
    assert np.mean(np.abs(wrong) < 1.96 * np.maximum(std, 0.01)) > 0.9
    resistance = StepResistanceEstimator().estimate(recording, EstimationContext((stepped,)))
    assert resistance.low < ohm < resistance.high
    assert resistance.high - resistance.low < 0.04 * ohm


@few(
    "wrong_with, code",
    [({"drop_v": 1.0, "drop_a": 0.05}, "inverter_loss"), ({"delay_samples": 2.4}, "steps_lag"), ({}, "")],
    ids=["drop", "lag", "nothing"],
)
def test_what_opens_the_loops_is_separated_and_does_not_move_the_map(
    wrong_with: dict[str, float], code: str, tmp_path: Path
) -> None:
    at = bench(1, **wrong_with)
    stepped = found(recorded(at, tmp_path))
    assert rms(errors(stepped.map, at)[0]) < 0.25
    assert [remark.code for remark in stepped.remarks] == ([code] if code else [])
    late = at.plant.delay_samples
    assert stepped.fit.lag_samples == pytest.approx(0.0, abs=0.05)
    if late:
        assert stepped.remarks[0].values["late"] == pytest.approx(late, abs=0.05)


@pytest.mark.slow
def test_an_axis_that_is_not_where_it_is_believed_shows_in_the_evenness(tmp_path: Path) -> None:
    stepped = found(recorded(bench(angle=0.03), tmp_path))
    assert stepped.fit.energy.angle_rad == pytest.approx(0.03, abs=0.002)


def test_ten_milliseconds_on_both_axes_at_once_are_enough(tmp_path: Path) -> None:
    at = bench()
    top = at.machine.top_a
    record_steps(at, [Steps((130.0, 108.0), (top, 0.7 * top), 0.01)] * 4, tmp_path / "steps")
    stepped = found(open_recording(tmp_path / "steps"))
    assert rms(errors(stepped.map, at)[0]) < 0.5


def test_one_level_of_one_sign_does_not_tell_a_drop_from_the_resistance(tmp_path: Path) -> None:
    """A step on d, a step on q, each to one current: R_s i + e is all that shows."""
    ohm, volts, rate, rows = 8.5, 2.72, 50e3, 1000
    time = (np.arange(rows) - 100) / rate
    rising = np.random.default_rng(3).normal(size=(2, rows)) * 0.004
    segments, captures = [], {}
    for k, (name, henry) in enumerate((("d", 5.4e-3), ("q", 9e-3))):
        on = time >= 0.0
        i, v = np.zeros((rows, 2)), np.zeros((rows, 2))
        v[:, k] = np.where(on, volts, 0.0)
        i[:, k] = np.where(on, volts / ohm * -np.expm1(-np.maximum(time, 0.0) * ohm / henry), 0.0)
        i[:, k] = np.round((i[:, k] + rising[k]) / 0.009) * 0.009
        # The supply is switched off at the end, and the current freewheels.
        v[-3:, k] = 0.0
        segments.append(Segment(id=name, stage=SegmentStage.STEPS, start_s=float(k), samples=rows))
        captures[name] = capture_of(i, v, rate, float(k))
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="scope",
        created="2026-01-01",
        motor=Motor(name="m", pole_pairs=7, stator_resistance_ohm=ohm),
        drive=DriveRecord(name="d", sampling_frequency_hz=rate, dc_bus_voltage_v=5.0),
        segments=tuple(segments),
    )
    stepped = found(MemoryRecording(manifest, captures))
    assert not stepped.fit.determines_resistance
    assert "resistance_undetermined" in [remark.code for remark in stepped.remarks]
    assert not {"inverter_loss", "steps_lag"} & {remark.code for remark in stepped.remarks}
    resistance = StepResistanceEstimator().estimate(MemoryRecording(manifest, captures), EstimationContext((stepped,)))
    assert resistance.low < ohm < resistance.high


def capture_of(i_ab: np.ndarray, v_ab: np.ndarray, rate: float, start_s: float) -> Capture:
    return Capture(
        i_ab=i_ab.astype(np.float32),
        v_ab=v_ab.astype(np.float32),
        v_dc=np.full(len(i_ab), 5.0, dtype=np.float32),
        sampling_frequency_hz=rate,
        start_s=start_s,
    )


def test_currents_on_one_line_are_one_clear_line(tmp_path: Path) -> None:
    recording = recorded(bench(), tmp_path, seconds=0.02)
    captures: dict[str, Capture] = {}
    for segment in recording.segments():
        capture = recording.load(segment)
        captures[segment.id] = capture.model_copy(
            update={"i_ab": capture.i_ab * np.array([1.0, 0.0], dtype=np.float32)}
        )
    with pytest.raises(NotMeasuredError, match="area"):
        found(MemoryRecording(recording.manifest, captures))


def test_without_steps_or_any_idea_of_the_resistance_no_map_is_made(tmp_path: Path) -> None:
    recording = recorded(bench(), tmp_path, seconds=0.02)
    with pytest.raises(NotMeasuredError, match="constant current"):
        found(believing(recording, None, None))
    with pytest.raises(NotMeasuredError, match="no segment of stage steps"):
        found(believing(recording, 4.0, None).with_segments(()))
