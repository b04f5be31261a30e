"""The drive `replay`: returns a recording's segments as captures of a procedure's excitations.

An excitation that the recording lacks is refused; nothing is interpolated. It serves to show a run again, live, and to
try estimators, streams and procedures on real measurements without a motor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from orchestrator.driving import DriveShell, in_blocks
from orchestrator.recording import Recording, open_recording
from plugins.drives.replay._matching import KIND_OF, answers, describe
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    Excitation,
    FaultCause,
    FluxbenchError,
    Limits,
    Segment,
    Strict,
    Telemetry,
)


class ReplayOptions(Strict):
    """Options of the drive `replay`."""

    recording: Path = Field(description="The recording, or run directory, to play.")
    real_time: bool = False
    """Play at the pace of the measurement; otherwise as fast as possible."""


class ReplayDrive(DriveShell):
    """A recording played back as a drive.

    Parameters
    ----------
    setup : DriveSetup
        With `ReplayOptions`.
    """

    name: ClassVar[str] = "replay"
    Options: ClassVar[type[BaseModel]] = ReplayOptions
    watchdog_s: ClassVar[float] = 0.2
    """Timeout of the heartbeat, as on a real drive, so that a failing heartbeat shows in a replay too."""
    headroom: ClassVar[float] = 4.0
    """Largest accepted limit over the rated current."""

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: ReplayOptions = setup.options
        self._scale_a = setup.motor.rated_current_a or 0.0
        self._recording: Recording | None = None
        self._played: set[str] = set()
        self._clock_s = 0.0
        self._current = 0j
        self._last_beat_s = 0.0

    def open(self) -> Capabilities:
        """Open the recording; returns the capabilities that it contains.

        Raises
        ------
        RecordingError
            Where it cannot be read.
        """
        recording = open_recording(self._options.recording)
        manifest = recording.manifest
        drive = manifest.drive
        pwm_hz = drive.pwm_frequency_hz or drive.sampling_frequency_hz
        others = {s.settings.get("pwm_frequency_hz") for s in manifest.segments}
        pwm_all = sorted({pwm_hz, *(float(f) for f in others if isinstance(f, int | float) and f > 0)})
        peak_a, peak_v = _peaks(recording)
        self._recording = recording
        kinds = frozenset(KIND_OF[s.stage] for s in manifest.segments if s.stage in KIND_OF)
        return Capabilities(
            name=f"replay of {manifest.name}",
            sampling_frequency_hz=drive.sampling_frequency_hz,
            pwm_frequency_hz=pwm_hz,
            pwm_frequencies_hz=tuple(pwm_all),
            dc_bus_voltage_v=drive.dc_bus_voltage_v,
            voltage_delay_samples=drive.voltage_delay_samples or 0.0,
            max_current_a=max(1.001 * peak_a, self.headroom * self._scale_a),
            max_voltage_v=max(1.001 * peak_v, drive.dc_bus_voltage_v / math.sqrt(3.0)),
            excitations=kinds,
            watchdog_s=self.watchdog_s,
            watchdog_covers=kinds,
            clock_is_simulated=True,
            motor_name=manifest.motor.name,
            simulated=True,
        )

    def energise(self, limits: Limits) -> None:
        """Nothing to switch on."""
        self.heartbeat()

    def heartbeat(self) -> None:
        """Note the host's heartbeat."""
        self._last_beat_s = time.monotonic()

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Play the first matching segment that was not played yet, else the last one.

        Raises
        ------
        DriveRefused
            Where the recording holds no such measurement.
        """
        recording, limits = self._recording, self.limits
        assert recording is not None
        assert limits is not None
        fitting = [s for s in recording.segments() if answers(s, excitation, recording.manifest, self._scale_a)]
        if not fitting:
            raise DriveRefused(f"{recording.path}: holds no {describe(excitation)} that is long enough")
        segment = next((s for s in fitting if s.id not in self._played), fitting[-1])
        try:
            capture = recording.load(segment)
        except FluxbenchError as error:
            raise DriveFault(FaultCause.WRONG_DATA, str(error)) from error
        rows = excitation.rows(capture.sampling_frequency_hz)
        largest_a = float(np.linalg.norm(capture.i_ab[:rows], axis=1).max())
        if not largest_a <= limits.current_a:
            raise DriveRefused(f"{segment.id} reaches {largest_a:.3g} A, above the limit of {limits.current_a:g} A")
        self._played.add(segment.id)
        start_s = max(segment.start_s, self._clock_s)
        start_s += 0.0 if start_s > self._clock_s else excitation.settling_s
        return self._play(capture.model_copy(update={"start_s": start_s}), rows, segment)

    def _play(self, capture: Capture, rows: int, segment: Segment) -> Iterator[Capture]:
        fs = capture.sampling_frequency_hz
        turn = np.exp(-1j * segment.rotor_angle_rad)
        for block in in_blocks(capture, 0.5 * self.watchdog_s, rows):  # short, to notice a missing heartbeat
            if self._options.real_time:
                time.sleep(len(block) / fs)
            silent_s = time.monotonic() - self._last_beat_s
            if silent_s > self.watchdog_s:
                raise self.trip(DriveFault(FaultCause.HEARTBEAT_LOST, f"no heartbeat for {silent_s:.2f} s"))
            self._clock_s = block.start_s + len(block) / fs
            self._current = complex(*block.i_ab.mean(axis=0)) * turn
            yield block

    def telemetry(self) -> Telemetry:
        """A reading, now."""
        bus_v = 0.0 if self._recording is None else self._recording.manifest.drive.dc_bus_voltage_v
        i = self._current
        return Telemetry(
            state=self.state, time_s=self._clock_s, i_d_a=i.real, i_q_a=i.imag, v_dc_v=bus_v, faults=self.faults
        )

    def ramp(self) -> None:
        """Stop playing."""
        self._current = 0j

    def set_brake(self, engaged: bool) -> None:
        """Refused: a recording has no brake to move."""
        raise DriveRefused("a recording has no brake to move")

    def release(self) -> None:
        """Close the recording."""
        self._recording = None

    def checkpoint(self, point_id: str) -> None:
        """Nothing to save: `restore` derives the played segments from the clock."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Continue after the segments before the experiment's clock."""
        self._clock_s = start_s
        if self._recording is not None:
            self._played = {s.id for s in self._recording.manifest.segments if s.start_s < start_s}


def _peaks(recording: Recording) -> tuple[float, float]:
    """Longest current and voltage vector of a recording."""
    peak_a = peak_v = 0.0
    for segment in recording.segments():
        capture = recording.load(segment)
        peak_a = max(peak_a, float(np.einsum("ij,ij->i", capture.i_ab, capture.i_ab).max()))
        peak_v = max(peak_v, float(np.einsum("ij,ij->i", capture.v_ab, capture.v_ab).max()))
    return math.sqrt(peak_a), math.sqrt(peak_v)
