from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from orchestrator.analysis import each_capture
from protocols import Capture, DriveRecord, Manifest, Motor, NotMeasuredError, Segment, SegmentStage
from tests.orchestrator.analysis.campaign import MemoryRecording


def recording_of(count: int) -> MemoryRecording:
    segments = tuple(
        Segment(id=f"s-{k:02d}", stage=SegmentStage.INJECTION, start_s=float(k), samples=2) for k in range(count)
    )
    blank = Capture(
        start_s=0.0, sampling_frequency_hz=1e4, i_ab=np.zeros((2, 2)), v_ab=np.zeros((2, 2)), v_dc=np.zeros(2)
    )
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="made up",
        created="2026-01-01",
        motor=Motor(name="m", pole_pairs=2),
        drive=DriveRecord(name="d", sampling_frequency_hz=1e4, dc_bus_voltage_v=540.0),
        segments=segments,
    )
    return MemoryRecording(manifest, {s.id: blank.model_copy(update={"start_s": s.start_s}) for s in segments})


@pytest.mark.parametrize("count", [0, 1, 20])
def test_results_come_in_the_order_of_the_segments(count: int) -> None:
    recording = recording_of(count)
    found = each_capture(recording, recording.segments(), lambda s, c: (s.id, c.start_s))
    assert found == [(s.id, s.start_s) for s in recording.segments()]


def test_no_thread_outlives_the_pass() -> None:
    recording, before = recording_of(20), threading.active_count()
    each_capture(recording, recording.segments(), lambda s, c: None)
    assert threading.active_count() == before


def test_what_a_segment_raises_ends_the_pass() -> None:
    recording, seen = recording_of(200), list[str]()

    def evaluate(segment: Segment, capture: Capture) -> None:
        seen.append(segment.id)
        time.sleep(1e-3)
        if segment.id == "s-03":
            raise NotMeasuredError(segment.id, "samples", "too few")

    with pytest.raises(NotMeasuredError, match="s-03"):
        each_capture(recording, recording.segments(), evaluate)
    assert len(seen) < 200
