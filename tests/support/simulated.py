"""A procedure measured by the simulated drive straight into memory: no engine, no files, no wall clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.config import PlannedPoint, make_plan
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, TrueMagnetics, true_flux
from plugins.drives.simulated._state import HEAT
from protocols import Capture, DriveRecord, DriveSetup, Manifest, Procedure, Segment, SegmentStage
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.plant import Array

NEEDED = (SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)
"""What estimators read; other stages are neither measured nor waited for."""


@dataclass(frozen=True)
class Measured:
    """A recording, and what the plant behind it truly is."""

    recording: MemoryRecording
    procedure: Procedure
    truth: TrueMagnetics
    time_s: Array
    ohm: Array
    """R_s at these instants, shape (n,) each; it runs straight between them."""

    def ohm_at(self, time_s: Array | float) -> Array:
        """R_s at any time since the start of the experiment."""
        return np.asarray(np.interp(time_s, self.time_s, self.ohm))


def measure(procedure: Procedure) -> Measured:
    """Run a procedure's measuring stages on its simulated drive."""
    stages = tuple(s for s in procedure.stages if s.kind in {stage.value for stage in NEEDED})
    procedure = procedure.model_copy(update={"stages": stages})
    options = SimulatedOptions.model_validate({**procedure.drive.options, "watchdog_s": None})
    drive = SimulatedDrive(DriveSetup(motor=procedure.motor, options=options, seed=procedure.seed))
    capabilities = drive.connect()
    drive.arm(procedure.limits)
    cold = options.plant.resistance_ohm or procedure.motor.stator_resistance_ohm
    assert cold is not None
    points = make_plan(procedure, capabilities).points
    captures, heat = {}, [(0.0, 0.0)]
    for point in points:
        captures[point.id] = _executed(drive, point, heat)
    drive.close()
    time_s, warmer = np.array(heat).T
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name=procedure.name,
        created="2026-01-01T00:00:00Z",
        motor=procedure.motor,
        drive=DriveRecord(
            name="simulated",
            sampling_frequency_hz=capabilities.sampling_frequency_hz,
            pwm_frequency_hz=capabilities.pwm_frequency_hz,
            dc_bus_voltage_v=capabilities.dc_bus_voltage_v,
            voltage_delay_samples=capabilities.voltage_delay_samples,
        ),
        segments=tuple(_segment(point, captures[point.id]) for point in points),
    )
    return Measured(
        MemoryRecording(manifest, captures),
        procedure,
        true_flux(options, procedure.motor),
        time_s,
        cold * (1.0 + warmer),
    )


def _executed(drive: SimulatedDrive, point: PlannedPoint, heat: list[tuple[float, float]]) -> Capture:
    """All blocks as one capture; `heat` grows by the time after each, and how much the resistance has risen."""
    blocks = []
    for block in drive.execute(point.excitation):
        heat.append((drive._plant.time_s, float(drive._plant.memory.state[HEAT])))
        if len(block):
            blocks.append(block)
    return joined(blocks)


def joined(blocks: Sequence[Capture]) -> Capture:
    """Blocks that follow one another, as one capture."""
    return Capture(
        start_s=blocks[0].start_s,
        sampling_frequency_hz=blocks[0].sampling_frequency_hz,
        i_ab=np.concatenate([block.i_ab for block in blocks]),
        v_ab=np.concatenate([block.v_ab for block in blocks]),
        v_dc=np.concatenate([block.v_dc for block in blocks]),
    )


def _segment(point: PlannedPoint, capture: Capture) -> Segment:
    return Segment(
        id=point.id,
        stage=point.stage,
        start_s=capture.start_s,
        samples=len(capture),
        rotor_angle_rad=point.excitation.rotor_angle_rad,
        settings=point.settings,
    )
