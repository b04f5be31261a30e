"""One pass over segments of a recording, several in parallel, with a function of the caller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from orchestrator.operating_system.processes import available_cores
from protocols import Capture, RecordingReader, Segment

T = TypeVar("T")


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
