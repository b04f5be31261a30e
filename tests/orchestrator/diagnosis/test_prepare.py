"""What the diagnosis lets in: too little is refused in one line, and what cannot be reported is stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis import compare_recording, diagnose_recording
from orchestrator.diagnosis._prepare import open_for_diagnosis, rounding_remarks
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import from_phases, from_two_phases, to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from orchestrator.recording import Recording, SegmentWriter, open_recording, write_manifest
from protocols import Capture, NotMeasuredError, Segment, SegmentStage
from tests.orchestrator.diagnosis.pieces import NOISE_A, Plan, piece, sweep
from tests.support.cases import few

HOLDS, SWEEPS, INJECTION = SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION
Change = Callable[[Capture], Capture]


def _with(recording: Recording, directory: Path, wanted: Callable[[Segment], bool], samples: int = 0) -> Recording:
    """The same recording without some of its segments, each cut to so many samples."""
    (directory / "captures").mkdir(parents=True)
    kept = []
    for segment in filter(wanted, recording.manifest.segments):
        whole = recording.load(segment)
        cut = slice(0, samples or len(whole))
        capture = whole.model_copy(update={n: getattr(whole, n)[cut] for n in ("i_ab", "v_ab", "v_dc")})
        with SegmentWriter(directory, segment.id) as writer:
            writer.append(capture)
            written = writer.finish()
        kept.append(segment.model_copy(update={"samples": written.samples, "sha256": written.sha256}))
    write_manifest(directory, recording.manifest.model_copy(update={"segments": tuple(kept)}))
    return open_recording(directory)


def _named(*names: str) -> Callable[[Segment], bool]:
    return lambda s: s.id in names


def _of(*stages: SegmentStage) -> Callable[[Segment], bool]:
    return lambda s: s.stage in stages


def _all(segment: Segment) -> bool:
    return True


@few("wanted, samples", [
        (_named("resistance-011"), 0),
        (_of(SegmentStage.GATES_OFF), 0),
        (_of(SegmentStage.GATES_OFF, HOLDS), 20),
        (_named("classical-012"), 2000),
        (_named("classical-012", "classical-013"), 0),
        (_named("injection-019", "injection-020", "injection-021"), 0),
        (_of(INJECTION), 20),
        (_all, 20),
        (_all, 1),
    ], fast=3,
    ids=["one hold", "gates off", "holds of 2 ms", "half a sweep", "two sweeps", "three points", "a period of each",
         "2 ms of all", "one sample of all"])  # fmt: skip
def test_too_little_is_refused_in_one_line(
    wanted: Callable[[Segment], bool], samples: int, clean: Recording, tmp_path: Path
) -> None:
    little = _with(clean, tmp_path / "little", wanted, samples)
    for held in (compare_recording, diagnose_recording):
        with pytest.raises(NotMeasuredError, match=r"too few|long enough") as caught:
            held(little, [])
        assert "\n" not in str(caught.value)
    assert not (little.path / "model.json").exists()


def test_one_point_measured_again_and_again_is_one_place(clean: Recording, tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    hold = next(s for s in clean.manifest.segments if s.id == "resistance-011")
    copies = tuple(hold.model_copy(update={"id": f"resistance-{k:03d}", "start_s": float(k)}) for k in range(20))
    for copy in copies:
        (tmp_path / "captures" / f"{copy.id}.parquet").symlink_to(clean.path / "captures" / f"{hold.id}.parquet")
    write_manifest(tmp_path, clean.manifest.model_copy(update={"segments": copies}))
    with pytest.raises(NotMeasuredError, match="show 1 operating point:"):
        open_for_diagnosis(open_recording(tmp_path))


def test_what_few_places_cannot_tell_is_stated(clean: Recording, tmp_path: Path) -> None:
    reported = {remark.code for remark in open_for_diagnosis(_with(clean, tmp_path / "holds", _of(HOLDS))).remarks}
    assert {"few_places", "nothing_moves", "no_gates_off", "no_injection"} <= reported
    assert "few_places" not in {remark.code for remark in open_for_diagnosis(clean).remarks}


def test_a_recording_that_cannot_be_a_motor_s_is_refused(clean: Recording, tmp_path: Path) -> None:
    motor = clean.manifest.motor.model_copy(update={"rated_current_rms_a": 0.01})
    (tmp_path / "captures").symlink_to(clean.path / "captures")
    write_manifest(tmp_path, clean.manifest.model_copy(update={"motor": motor}))
    with pytest.raises(NotMeasuredError, match=r"resistance-\d+: i_alpha, i_beta: .* times the rated current"):
        open_for_diagnosis(open_recording(tmp_path))


def test_a_recording_sampled_too_slowly_is_refused(clean: Recording, tmp_path: Path) -> None:
    drive = clean.manifest.drive.model_copy(update={"sampling_frequency_hz": 300.0})
    (tmp_path / "captures").symlink_to(clean.path / "captures")
    write_manifest(tmp_path, clean.manifest.model_copy(update={"drive": drive}))
    with pytest.raises(NotMeasuredError, match="300 Hz is too slow"):
        open_for_diagnosis(open_recording(tmp_path))


@pytest.mark.slow
def test_currents_ten_times_too_small_for_the_nameplate_are_diagnosed(clean: Recording, tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    for segment in clean.manifest.segments:
        whole = clean.load(segment)
        with SegmentWriter(tmp_path, segment.id) as writer:
            writer.append(whole.model_copy(update={"i_ab": 0.1 * whole.i_ab}))
            writer.finish()
    segments = tuple(s.model_copy(update={"sha256": None}) for s in clean.manifest.segments)
    write_manifest(tmp_path, clean.manifest.model_copy(update={"segments": segments}))
    report = diagnose_recording(open_recording(tmp_path), []).report
    assert report.convention is None
    assert report.verdict == "clean"
    assert report.remarks[0].code == "nameplate_or_readings"
    assert "currents scaled by 0.1 (a decimal point)" in report.remarks[0].text


def test_equations_without_a_solution_are_one_line(clean: Recording) -> None:
    @solvable
    def singular(recording: Recording) -> None:
        np.linalg.inv(np.zeros((2, 2)))

    with pytest.raises(NotMeasuredError, match="clean: its equations have no solution"):
        singular(clean)


NOISE = SensorNoise(NOISE_A**2 * np.eye(2), NOISE_A**2 * np.eye(2), 0.0)
ANGLE = 0.3
Rounding = Callable[[Array, float], Array]


def to(step: float) -> Callable[[Array], Array]:
    return lambda x: np.asarray(np.round(x / step) * step, dtype=np.float64)


ROUNDINGS: dict[str, Rounding] = {
    "alpha, beta": lambda x, step: to(step)(x),
    "d, q": lambda x, step: to_ab(to(step)(to_dq(x, ANGLE)), ANGLE),
    "phases": lambda x, step: from_phases(to(step)(to_phases(x))),
    "two phases": lambda x, step: from_two_phases(*to(step)(to_phases(x)[:, :2]).T),
}


def a_sweep() -> SegmentData:
    noise = np.random.default_rng(1).normal(0.0, NOISE_A, (1200, 2))
    return piece(Plan(SegmentStage.CLASSICAL, sweep(0, 2.0, 0.5, 1200)), angle=ANGLE, noise=noise)


@pytest.mark.parametrize("frame", ROUNDINGS)
def test_voltages_that_were_logged_in_large_steps_are_reported(frame: str) -> None:
    one = a_sweep()
    rounded = replace(one, command_ab=ROUNDINGS[frame](one.command_ab, 0.5))
    (stated,) = rounding_remarks([rounded], NOISE)
    assert stated.code == "rounded_voltages"
    assert stated.values["step_v"] == pytest.approx(0.5)


def test_steps_that_do_not_show_and_none_at_all_are_not_spoken_of() -> None:
    one = a_sweep()
    assert rounding_remarks([one], NOISE) == []
    assert rounding_remarks([replace(one, command_ab=to(1e-3)(one.command_ab))], NOISE) == []
    assert rounding_remarks([replace(one, current_ab=to(NOISE_A)(one.current_ab))], NOISE) == []
    assert rounding_remarks([], NOISE) == []


@pytest.mark.parametrize("frame", ROUNDINGS)
def test_currents_that_were_logged_in_steps_beyond_their_noise_are_reported(frame: str) -> None:
    one = a_sweep()
    rounded = replace(one, current_ab=ROUNDINGS[frame](one.current_ab, 5.0 * NOISE_A))
    (stated,) = rounding_remarks([rounded], NOISE)
    assert stated.code == "rounded_currents"
    assert stated.values["step_a"] == pytest.approx(5.0 * NOISE_A)
