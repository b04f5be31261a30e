"""Rotor and dq-frame angles: a segment's believed angle, and checks of the angle unit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from orchestrator.importing._findings import Finding, Findings
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._signals import Angle
from orchestrator.importing._source import Numbers
from orchestrator.importing._splitting import RawSegment
from orchestrator.importing._timing import at
from orchestrator.importing._vectors import Columns, angle_rad
from protocols import SegmentStage

_FREE_ROTOR_STAGES = (SegmentStage.ALIGNMENT, SegmentStage.LOCK_CHECK, SegmentStage.GATES_OFF, SegmentStage.SPIN)
"""Stages in which the rotor may move."""


def check_fixed_angles(mapping: ImportMapping, path: Path, findings: Findings) -> None:
    """Report fixed angles in the mapping file at `path` whose unit is implausible."""
    named = [
        ("rotor_angle", mapping.rotor_angle),
        ("current.angle", mapping.current.angle),
        ("voltage.angle", mapping.voltage.angle),
        *((f"segments.{index}.rotor_angle", rule.rotor_angle) for index, rule in enumerate(mapping.segments)),
    ]
    for name, angle in named:
        if angle is not None and angle.value is not None and _beyond_a_turn(angle, abs(angle.value)):
            findings.doubt(Finding.ANGLE_UNIT, str(path), name, _doubtful(angle.value))


def check_angle_column(angle: Angle, raw: RawSegment, columns: Columns, findings: Findings) -> None:
    """Report a column of angles whose unit is implausible."""
    if angle.column is None:
        return
    values = (columns[angle.column] - angle.offset) * angle.factor
    worst = int(np.argmax(np.abs(values)))
    if _beyond_a_turn(angle, abs(float(values[worst]))):
        findings.doubt(
            Finding.ANGLE_UNIT,
            str(raw.path),
            angle.column,
            f"{_doubtful(float(values[worst]))} (from {at(raw, 0)} on)",
        )


def believed_angle_rad(
    angle: Angle, stage: SegmentStage, raw: RawSegment, columns: Columns, pole_pairs: int, findings: Findings
) -> tuple[float, float | Numbers]:
    """The segment's rotor angle for the manifest (circular mean of a column), and the angle per sample."""
    theta = angle_rad(angle, columns, pole_pairs)
    if isinstance(theta, float):
        return theta, theta
    turned = np.unwrap(theta)
    moved = float(np.ptp(turned))
    if moved > 0.1 and stage not in _FREE_ROTOR_STAGES:
        findings.doubt(
            Finding.MOVING_ROTOR,
            str(raw.path),
            angle.column or "",
            f"a locked rotor's angle changes by {moved:.3g} rad in the segment from {at(raw, 0)} on",
        )
    return float(np.angle(np.mean(np.exp(1j * theta)))), theta


def _beyond_a_turn(angle: Angle, value: float) -> bool:
    return angle.unit == "rad" and value > 2.0 * math.pi + 1e-3


def _doubtful(value: float) -> str:
    return f"{value:g} rad is beyond a turn; read in rad, deg would fit"
