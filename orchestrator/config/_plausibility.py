"""What no motor has and no test bench does: numbers that are slips of a unit or of the keyboard. Knows no limits."""

from __future__ import annotations

from collections.abc import Iterator

from orchestrator._plausible import DRIVE_RANGES, MOTOR_RANGES, outside
from protocols import Procedure

_LONGEST_SETTING_S = 86_400.0
"""A day: for one setting of one stage."""

Path = tuple[str | int, ...]


def implausible(procedure: Procedure) -> Iterator[tuple[Path, str]]:
    """Key path and problem of every number that cannot be meant."""
    for name, problem in outside(procedure.motor.model_dump(), MOTOR_RANGES, "no motor has that"):
        yield ("motor", name), problem
    for name, problem in outside(procedure.drive.options, DRIVE_RANGES, "no drive does that"):
        yield ("drive", name), problem
    for index, stage in enumerate(procedure.stages):
        for name, value in stage:
            if name.endswith("_s") and isinstance(value, float) and value > _LONGEST_SETTING_S:
                yield ("stages", index, name), f"{value:g} s is more than a day"
