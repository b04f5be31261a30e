"""Injection near the current limit of a motor that saturates violently: no trip, and no point lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunResult, RunServices, resume_run
from orchestrator.recording import open_recording
from plugins.drives.simulated import map_motor
from protocols import Note, PointDone
from tests.support.tiny import messages_of, run_tiny

BALDOR = map_motor("baldor-5k6").model_dump(exclude_none=True)
LIMIT_A = 20.0
POINTS = [[0.0, 0.0], [8.0, 8.0], [16.0, 0.0], [0.0, 16.0], [0.0, -16.0], [-16.0, 0.0]]
STAGE: dict[str, Any] = {
    "kind": "injection",
    "points_a": POINTS,
    "amplitudes_v": [120.0, 60.0],
    "rotation_hz": 10.0,
    "settle_s": 1.0,
    "duration_s": 0.1,
}


def run_baldor(folder: Path, *, stage: dict[str, Any] = STAGE, interrupts: Interrupts | None = None) -> RunResult:
    return run_tiny(
        folder,
        interrupts=interrupts,
        drive={"plant": {"magnetics": {"kind": "map", "name": "baldor-5k6"}}},
        motor=BALDOR,
        limits={"current_a": LIMIT_A, "voltage_v": 450.0},
        stages=[stage],
    )


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    result = run_baldor(tmp_path_factory.mktemp("swept"))
    assert result.outcome.ending == "finished", result.outcome.reason
    return result.path


def test_the_whole_range_is_reached_within_the_limit(swept: Path) -> None:
    recording = open_recording(swept)
    reached = [(s.settings["target_d_a"], s.settings["target_q_a"]) for s in recording.segments()]
    assert reached == [tuple(p) for p in POINTS] + [tuple(p) for p in reversed(POINTS)]
    for segment in recording.segments():
        assert np.linalg.norm(recording.load(segment).i_ab, axis=1).max() < LIMIT_A, segment.id


def test_what_was_requested_is_what_the_segments_say(swept: Path) -> None:
    recording = open_recording(swept)
    amplitudes = [segment.settings["amplitude_v"] for segment in recording.segments()]
    strong, weak = amplitudes[0], amplitudes[-1]
    assert amplitudes == [strong] * len(POINTS) + [weak] * len(POINTS)  # one strength: one map
    assert 20.0 < strong < 80.0
    assert weak == pytest.approx(0.5 * strong, rel=0.01)
    # What the drive gave is that, less what its delay and the turning take from a sample.
    capture = recording.load(recording.segments()[0])
    assert np.linalg.norm(capture.v_ab - capture.v_ab.mean(axis=0), axis=1).max() == pytest.approx(strong, rel=0.05)


def test_a_person_is_reported_by_how_much(swept: Path) -> None:
    (note,) = [m.text for m in messages_of(swept) if isinstance(m, Note) and "of the plan" in m.text]
    assert "% of the plan" in note


@pytest.mark.slow
def test_a_resumed_stage_keeps_its_strength(swept: Path, tmp_path: Path) -> None:
    class StopAtSecond(Interrupts):
        def check(self) -> None:
            journal = tmp_path / "run" / "journal.jsonl"
            if journal.exists() and sum(isinstance(m, PointDone) for m in messages_of(tmp_path / "run")) >= 2:
                self.stop("enough")
            super().check()

    assert run_baldor(tmp_path, interrupts=StopAtSecond()).outcome.ending == "aborted"
    assert resume_run(tmp_path / "run", RunServices(AbsentOperator(), Interrupts())).outcome.ending == "finished"
    samples = {segment.id: segment.sha256 for segment in open_recording(tmp_path / "run").segments()}
    assert samples == {segment.id: segment.sha256 for segment in open_recording(swept).segments()}


def test_a_stage_with_room_is_measured_as_it_is_planned(tmp_path: Path) -> None:
    path = run_baldor(tmp_path, stage={**STAGE, "points_a": POINTS[:2], "amplitudes_v": [60.0]}).path
    assert {segment.settings["amplitude_v"] for segment in open_recording(path).segments()} == {60.0}
    assert not [m for m in messages_of(path) if isinstance(m, Note) and "of the plan" in m.text]
