"""The paper's sweeps on the simulated drive, captured in memory without files.

Single sources of error can be switched on, in half a minute each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np

from orchestrator.config import PlannedPoint, make_plan
from plugins.commands.reproduction.literal._evaluation import Measured
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, TrueMagnetics, true_flux
from protocols import Capture, DriveSetup, Injection, Procedure, Segment, SegmentStage

SWEEPS = (SegmentStage.CLASSICAL, SegmentStage.INJECTION)


def with_plant(procedure: Procedure, plant: Mapping[str, Any]) -> Procedure:
    """The procedure's sweeps alone, on its simulated drive with another plant."""
    stages = tuple(stage for stage in procedure.stages if stage.kind in {one.value for one in SWEEPS})
    drive = procedure.drive.model_validate({**procedure.drive.model_dump(), "plant": dict(plant), "watchdog_s": None})
    return procedure.model_copy(update={"stages": stages, "drive": drive})


def plant_of(procedure: Procedure) -> dict[str, Any]:
    """The plant's options in a procedure."""
    return dict(procedure.drive.options.get("plant") or {})


def truth_of(procedure: Procedure) -> TrueMagnetics:
    """The true magnetics of a procedure's simulated drive."""
    return true_flux(SimulatedOptions.model_validate(procedure.drive.options), procedure.motor)


def measured_by(procedure: Procedure, *, standing: bool = False) -> Iterator[Measured]:
    """Run a procedure's classical sweeps and its injection, a sweep or an operating point at a time.

    Parameters
    ----------
    procedure : Procedure
        From `with_plant`.
    standing : bool
        Whether the injection is along d and then along q, for half the time each, instead of rotating.
    """
    options = SimulatedOptions.model_validate(procedure.drive.options)
    drive = SimulatedDrive(DriveSetup(motor=procedure.motor, options=options, seed=procedure.seed))
    capabilities = drive.connect()
    try:
        drive.arm(procedure.limits)
        for point in make_plan(procedure, capabilities).points:
            parts = _standing(point) if standing else [point]
            yield [_executed(drive, part) for part in parts]
        drive.ramp_down()
    finally:
        drive.disarm()
        drive.close()


def _standing(point: PlannedPoint) -> list[PlannedPoint]:
    """Two points with an injection along d and along q (in a believed frame rotated by 90 degrees)."""
    injection = point.excitation
    if not isinstance(injection, Injection):
        return [point]
    d, q = injection.start_dq_a
    on_d = injection.model_copy(update={"rotation_hz": 0.0, "duration_s": injection.duration_s / 2.0})
    turned = {"rotor_angle_rad": injection.rotor_angle_rad + pi / 2.0, "target_d_a": q, "target_q_a": -d}
    return [replace(point, excitation=one) for one in (on_d, on_d.model_copy(update=turned))]


def _executed(drive: SimulatedDrive, point: PlannedPoint) -> tuple[Segment, Capture]:
    blocks = [block for block in drive.execute(point.excitation) if len(block)]
    capture = Capture(
        start_s=blocks[0].start_s,
        sampling_frequency_hz=blocks[0].sampling_frequency_hz,
        i_ab=np.concatenate([block.i_ab for block in blocks]),
        v_ab=np.concatenate([block.v_ab for block in blocks]),
        v_dc=np.concatenate([block.v_dc for block in blocks]),
    )
    segment = Segment(
        id=point.id,
        stage=point.stage,
        start_s=capture.start_s,
        samples=len(capture),
        rotor_angle_rad=point.excitation.rotor_angle_rad,
        settings=point.excitation.model_dump(),
    )
    return segment, capture
