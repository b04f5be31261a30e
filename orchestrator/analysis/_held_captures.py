"""A recording that caches its waveforms within a memory limit."""

from __future__ import annotations

from collections.abc import Sequence

from protocols import Capture, Manifest, RecordingReader, Segment, SegmentStage


class HeldCaptures:
    """A `protocols.RecordingReader` for repeated reading of a recording.

    Parameters
    ----------
    recording : RecordingReader
    max_samples : int
        Total of the cached segments, which are the first that are read. Two million samples take some 50 MB.
    """

    def __init__(self, recording: RecordingReader, max_samples: int = 2_000_000) -> None:
        self._recording, self._room = recording, max_samples
        self._held: dict[str, Capture] = {}

    @property
    def manifest(self) -> Manifest:
        return self._recording.manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        """The segments of these stages (of all, where none is named), in order of time."""
        return self._recording.segments(*stages)

    def load(self, segment: Segment) -> Capture:
        """The segment's waveforms, not to be written to; raises what the recording's own `load` raises."""
        capture = self._held.get(segment.id)
        if capture is None:
            capture = self._recording.load(segment)
            if segment.samples <= self._room:
                self._room -= segment.samples
                self._held[segment.id] = capture
        return capture
