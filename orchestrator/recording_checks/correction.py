"""A recording with a convention's correction applied in memory. Nothing on the disk changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from orchestrator.numerics.frames import to_dq
from protocols import Capture, Manifest, ManifestCorrection, Motor, RealArray, RecordingReader, Segment, SegmentStage


class CorrectedRecording:
    """A `protocols.RecordingReader` that corrects the manifest and the captures of another one.

    Parameters
    ----------
    recording : RecordingReader
    correction : ManifestCorrection
        A correction without a field changes nothing.
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
        # The file belongs to the original segment.
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
    """The manifest, and the rows by which the voltage's column moves: a delay cannot be negative."""
    drive, factor, add = manifest.drive, correction.factor or 1.0, correction.add or 0.0
    if correction.field == "sampling_frequency_hz":
        drive = drive.model_copy(update={"sampling_frequency_hz": factor * drive.sampling_frequency_hz})
    if correction.field == "voltage_delay_samples":
        delay = (drive.voltage_delay_samples or 0.0) + add
        drive = drive.model_copy(update={"voltage_delay_samples": max(delay, 0.0)})
        return manifest.model_copy(update={"drive": drive}), round(max(-delay, 0.0))
    segments, motor = manifest.segments, manifest.motor
    if correction.field in ("rotor_angle_rad", "axes"):
        segments = tuple(s.model_copy(update={"rotor_angle_rad": factor * s.rotor_angle_rad + add}) for s in segments)
    if correction.field == "axes":
        segments = tuple(s.model_copy(update={"settings": _turned_back(s.settings, add)}) for s in segments)
        motor = _on_the_magnets_axis(motor)
    return manifest.model_copy(update={"drive": drive, "motor": motor, "segments": segments}), 0


def _turned_back(settings: Mapping[str, Any], turn_rad: float) -> dict[str, Any]:
    """Set-points in a frame that has been turned by an angle."""
    turned = dict(settings)
    for d, q in (("current_d_a", "current_q_a"), ("target_d_a", "target_q_a")):
        if all(isinstance(settings.get(name), int | float) for name in (d, q)):
            turned[d], turned[q] = to_dq(np.array([[settings[d], settings[q]]]), turn_rad)[0].tolist()
    return turned


def _on_the_magnets_axis(motor: Motor) -> Motor:
    """The nameplate with d along the magnet, where the inductance is the smaller one."""
    d, q = motor.d_inductance_h, motor.q_inductance_h
    if d is None or q is None or d <= q:
        return motor
    return motor.model_copy(update={"d_inductance_h": q, "q_inductance_h": d})
