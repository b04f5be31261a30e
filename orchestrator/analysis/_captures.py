"""Reading the captures of a recording: cached within a memory limit, or several in parallel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from orchestrator.operating_system.processes import available_cores
from protocols import Capture, Manifest, RecordingReader, Segment, SegmentStage

T = TypeVar("T")


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


def each_capture(
    recording: RecordingReader,
    segments: Sequence[Segment],
    evaluate: Callable[[Segment, Capture], T],
    at_once: int = 4,
) -> list[T]:
    """`evaluate` of each segment and its waveforms, in the order of the segments.

    Decoding and kernels release the interpreter's lock, so one thread per processor evaluates a segment each; only
    these segments are in memory. The threads end with the call. An exception of one segment ends the pass.

    Parameters
    ----------
    recording : RecordingReader
    segments : sequence of Segment
    evaluate : callable
        Called in any order and from several threads; must not hold on to the capture.
    at_once : int
        Maximum number of captures in memory.
    """

    def evaluate_segment(segment: Segment) -> T:
        return evaluate(segment, recording.load(segment))

    threads = min(at_once, len(segments), available_cores())
    if threads < 2:
        return [evaluate_segment(segment) for segment in segments]
    with ThreadPoolExecutor(threads, thread_name_prefix="pass") as pool:
        return list(pool.map(evaluate_segment, segments))
