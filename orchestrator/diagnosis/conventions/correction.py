"""A convention's correction at work: the recording as it would be, in memory. Nothing on the disk changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from protocols import Capture, Manifest, ManifestCorrection, RealArray, RecordingReader, Segment, SegmentStage


class CorrectedRecording:
    """A `protocols.RecordingReader` with a correction applied to what another one hands out.

    Parameters
    ----------
    recording : RecordingReader
    correction : ManifestCorrection
        One that names its field; any other leaves all as it is.
    """

    def __init__(self, recording: RecordingReader, correction: ManifestCorrection) -> None:
        self._recording, self._correction = recording, correction
        self._manifest, self._shift = _corrected(recording.manifest, correction)

    @property
    def manifest(self) -> Manifest:
        return self._manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        chosen = {s.id for s in self._recording.segments(*stages)}
        return [s for s in self._manifest.segments if s.id in chosen]

    def load(self, segment: Segment) -> Capture:
        """The segment's waveforms, corrected."""
        # The file is found by the segment that it was written for.
        own = next(s for s in self._recording.manifest.segments if s.id == segment.id)
        capture = self._recording.load(own)
        change: dict[str, object] = {"sampling_frequency_hz": self._manifest.drive.sampling_frequency_hz}
        turn = _turn(self._correction)
        if self._correction.field == "currents":
            change |= {"i_ab": turn(capture.i_ab), "i_abc": None}
        elif self._correction.field == "voltages":
            change["v_ab"] = turn(capture.v_ab)
        elif self._shift:
            rows = np.minimum(np.arange(len(capture)) + self._shift, len(capture) - 1)
            change["v_ab"] = capture.v_ab[rows]
        return capture.model_copy(update=change)


def _turn(correction: ManifestCorrection) -> Callable[[RealArray], RealArray]:
    if correction.matrix is not None:
        matrix = np.array(correction.matrix)
        return lambda x: np.asarray(x @ matrix.T)
    return lambda x: np.asarray(x * (correction.factor or 1.0))


def _corrected(manifest: Manifest, correction: ManifestCorrection) -> tuple[Manifest, int]:
    """The manifest, and by how many rows the voltage's column comes earlier: no delay is below none."""
    drive, factor, add = manifest.drive, correction.factor or 1.0, correction.add or 0.0
    if correction.field == "sampling_frequency_hz":
        drive = drive.model_copy(update={"sampling_frequency_hz": factor * drive.sampling_frequency_hz})
    if correction.field == "voltage_delay_samples":
        delay = (drive.voltage_delay_samples or 0.0) + add
        drive = drive.model_copy(update={"voltage_delay_samples": max(delay, 0.0)})
        return manifest.model_copy(update={"drive": drive}), round(max(-delay, 0.0))
    segments = manifest.segments
    if correction.field == "rotor_angle_rad":
        segments = tuple(s.model_copy(update={"rotor_angle_rad": factor * s.rotor_angle_rad + add}) for s in segments)
    return manifest.model_copy(update={"drive": drive, "segments": segments}), 0
