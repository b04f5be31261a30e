"""Waveforms are read once, as far as there is room for them."""

from __future__ import annotations

from orchestrator.analysis._captures import HeldCaptures
from orchestrator.recording import open_recording
from protocols import Capture, Segment, SegmentStage
from tests.orchestrator.interface.cli.test_refreshing import DATA


class Counting:
    """A recording that notes what is read of it."""

    def __init__(self) -> None:
        self._recording = open_recording(DATA)
        self.manifest, self.segments = self._recording.manifest, self._recording.segments
        self.read: list[str] = []

    def load(self, segment: Segment) -> Capture:
        self.read.append(segment.id)
        return self._recording.load(segment)


def test_a_segment_is_read_once_while_there_is_room() -> None:
    recording = Counting()
    first, second, third = recording.segments(SegmentStage.RESISTANCE)[:3]
    held = HeldCaptures(recording, max_samples=first.samples + second.samples)
    for _ in range(2):
        assert [held.load(one).start_s for one in (first, second, third)] == [
            one.start_s for one in (first, second, third)
        ]
    assert recording.read == [first.id, second.id, third.id, third.id]


def test_it_stands_for_the_recording() -> None:
    recording = Counting()
    held = HeldCaptures(recording)
    assert held.manifest is recording.manifest
    assert held.segments(SegmentStage.CLASSICAL) == recording.segments(SegmentStage.CLASSICAL)
