"""Recordings in disguise, for the estimator kit: read-only, turned in the stator frame, or empty. Reads no files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

import numpy as np

from orchestrator.numerics.frames import to_ab
from protocols import Capture, Manifest, RecordingReader, Segment, SegmentStage

ARRAYS = ("i_ab", "v_ab", "v_dc", "i_abc", "temperature_c", "theta_rad")


class Disguised:
    """A recording whose manifest and captures pass through two functions.

    Parameters
    ----------
    recording : RecordingReader
    capture : callable
        From a segment's capture to the one handed out.
    segment : callable
        From a manifest's segment to the one handed out.
    """

    def __init__(
        self,
        recording: RecordingReader,
        capture: Callable[[Capture], Capture] = lambda capture: capture,
        segment: Callable[[Segment], Segment] = lambda segment: segment,
    ) -> None:
        self._recording, self._capture = recording, capture
        self._original = {s.id: s for s in recording.manifest.segments}
        shown = tuple(segment(s) for s in recording.manifest.segments)
        self._manifest = recording.manifest.model_copy(update={"segments": shown})

    @property
    def manifest(self) -> Manifest:
        return self._manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        shown = {s.id: s for s in self._manifest.segments}
        return [shown[s.id] for s in self._recording.segments(*stages)]

    def load(self, segment: Segment) -> Capture:
        return self._capture(self._recording.load(self._original[segment.id]))


class Empty:
    """A recording of the same motor and drive in which only the sensors were read, with all gates off."""

    def __init__(self, manifest: Manifest) -> None:
        fs = manifest.drive.sampling_frequency_hz
        segment = Segment(id="gates_off-000", stage=SegmentStage.GATES_OFF, start_s=0.0, samples=int(fs))
        noise = np.random.default_rng(1).normal(0.0, 1e-3, (segment.samples, 2))
        self._manifest = manifest.model_copy(update={"segments": (segment,)})
        self._capture = Capture(
            start_s=0.0,
            sampling_frequency_hz=fs,
            i_ab=noise,
            v_ab=np.zeros_like(noise),
            v_dc=np.full(segment.samples, manifest.drive.dc_bus_voltage_v),
        )

    @property
    def manifest(self) -> Manifest:
        return self._manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self._manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        return read_only(self._capture)


def turned(recording: RecordingReader, angle_rad: float) -> Disguised:
    """The same measurement as a stator frame turned by `angle_rad` would have seen it."""
    return Disguised(
        recording,
        lambda capture: capture.model_copy(
            update={
                "i_ab": to_ab(capture.i_ab, angle_rad),
                "v_ab": to_ab(capture.v_ab, angle_rad),
                "i_abc": None,
                "theta_rad": None if capture.theta_rad is None else capture.theta_rad + angle_rad,
            }
        ),
        lambda segment: segment.model_copy(update={"rotor_angle_rad": segment.rotor_angle_rad + angle_rad}),
    )


def read_only(capture: Capture) -> Capture:
    """The same capture in arrays that cannot be written to."""
    views = {}
    for name in ARRAYS:
        array = getattr(capture, name)
        if array is not None:
            views[name] = array.view()
            views[name].flags.writeable = False
    return capture.model_copy(update=views)


def digest(recording: RecordingReader) -> str:
    """SHA-256 over the manifest and all waveforms."""
    sha = hashlib.sha256(recording.manifest.model_dump_json().encode())
    for segment in recording.segments():
        capture = recording.load(segment)
        for name in ARRAYS:
            array = getattr(capture, name)
            sha.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()
