"""Measures one point: the drive executes, the samples are checked and written, the journal records it."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from orchestrator.config import PlannedPoint
from orchestrator.driving.readings import ReadingCheck
from orchestrator.engine._alignment import AlignmentCheck
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._power import PowerStage
from orchestrator.engine._thermometer import LoggedTemperature, Thermometer
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.recording import SegmentWriter
from orchestrator.runs import RunDirectory
from protocols import Capabilities, Capture, DriveFault, FaultCause, Limits, Note, SamplesCaptured, Segment


class MeanCurrent:
    """Mean of the current over the blocks of a segment, in the believed frame."""

    def __init__(self, rotor_angle_rad: float) -> None:
        self._angle, self._turn = rotor_angle_rad, np.exp(-1j * rotor_angle_rad)
        self._sum = 0j
        self.samples = self.clipped_rows = 0

    def add(self, capture: Capture) -> None:
        i_ab = capture.i_ab if capture.theta_rad is None else to_ab(to_dq(capture.i_ab, capture.theta_rad), self._angle)
        alpha, beta = i_ab.sum(axis=0, dtype=np.float64)
        self._sum += complex(alpha, beta)
        self.samples += len(capture)
        self.clipped_rows += capture.clipped_rows

    def dq(self) -> tuple[float, float]:
        """(i_d, i_q) [A]."""
        mean = self._turn * self._sum / max(self.samples, 1)
        return float(mean.real), float(mean.imag)


class Measurement:
    """Takes points from the drive to the disk.

    Every block is checked as it comes, against the time base, the row count, bus and limits, and the
    winding's own equation: a drive that sends wrong data is a fault, and its segment never
    appears in the recording.
    """

    def __init__(
        self,
        run: RunDirectory,
        power: PowerStage,
        log: RunLog,
        interrupts: Interrupts,
        capabilities: Capabilities,
        limits: Limits,
        thermometer: Thermometer | None = None,
    ) -> None:
        self._thermometer, self._missed = thermometer, False
        self._run, self._power, self._log = run, power, log
        self._interrupts, self._capabilities = interrupts, capabilities
        self._alignment, self._readings = AlignmentCheck(capabilities), ReadingCheck(capabilities, limits)
        SegmentWriter.warm_up()

    def measure(self, point: PlannedPoint) -> tuple[Segment, tuple[float, float]]:
        """Execute and write one point.

        Returns
        -------
        segment : Segment
            As the manifest will list it.
        achieved_a : tuple of float
            Mean (i_d, i_q) over the segment.

        Raises
        ------
        DriveFault
            The drive tripped, was lost, or sent invalid data.
        StorageError
            The disk does not take it.
        RunInterrupted
            A stop was requested.
        """
        angle = point.excitation.rotor_angle_rad
        mean = MeanCurrent(angle)
        temperature = self._temperature(point.id)
        blocks = self._power.execute(point.excitation, quiet_s=point.seconds)
        self._alignment.begin()
        self._readings.begin(point.id, point.excitation)
        with SegmentWriter(self._run.path, point.id) as writer, closing(blocks):
            for capture in blocks:
                self._interrupts.check()
                if len(capture) == 0:  # a keepalive while the drive settles
                    continue
                capture = temperature.put_into(capture)
                writer.append(capture)
                self._readings.check(capture)
                mean.add(capture)
                self._alignment.update(point.excitation, capture)
                self._log.publish(SamplesCaptured(segment=point.id, rotor_angle_rad=angle, capture=capture))
            self._interrupts.check()
            self._check_length(point, mean.samples)
            self._power.require_interlocks()
            self._readings.conclude()
            self._alignment.conclude(point.id)
            written = writer.finish()
        segment = Segment(
            id=point.id,
            stage=point.stage,
            start_s=written.start_s,
            samples=written.samples,
            rotor_angle_rad=angle,
            settings=point.settings,
            sha256=written.sha256,
            clipped_rows=mean.clipped_rows,
        )
        if mean.clipped_rows:
            rows = f"{mean.clipped_rows} of {mean.samples} rows"
            message = f"{point.id}: {rows} are at the end of the drive's scale (clipped)"
            self._log.publish(Note(level="warning", text=message))
        return segment, mean.dq()

    def _temperature(self, segment: str) -> LoggedTemperature:
        temperature = LoggedTemperature(self._thermometer)
        if temperature.missing and not self._missed:
            message = "no new reading of the thermometer: no temperature is recorded until there is one"
            self._log.publish(Note(level="warning", text=f"{segment}: {message}"))
        self._missed = temperature.missing
        return temperature

    def _check_length(self, point: PlannedPoint, samples: int) -> None:
        expected = point.excitation.rows(self._capabilities.sampling_frequency_hz)
        if abs(samples - expected) > 1:
            raise DriveFault(FaultCause.WRONG_DATA, f"{point.id}: {samples} samples came, {expected} were requested")
