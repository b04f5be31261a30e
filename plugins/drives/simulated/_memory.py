"""Checkpoints of the simulated drive: JSON in the private directory, replaced by rename, two kept."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._simulator import Memory
from plugins.drives.simulated.truth import write_json
from protocols import DriveRefused, Strict


class _Checkpoint(Strict):
    point_id: str
    state: tuple[float, ...]
    ticks: int
    base_s: float
    angle_rad: float
    base_v: tuple[float, float]
    open_loop: bool
    number: int
    braked: bool
    bandwidth_hz: float
    damping: float
    fired: tuple[int, ...]


@dataclass(frozen=True)
class Saved:
    """What a checkpoint holds beside the plant's memory."""

    memory: Memory
    number: int
    """Excitations so far."""
    braked: bool
    bandwidth_hz: float
    damping: float
    fired: tuple[int, ...]


def save(directory: Path, point_id: str, saved: Saved) -> None:
    """Write a checkpoint and remove all but the last two."""
    m = saved.memory
    content = _Checkpoint(
        point_id=point_id,
        state=tuple(m.state.tolist()),
        ticks=m.ticks,
        base_s=m.base_s,
        angle_rad=m.angle_rad,
        base_v=m.base_v,
        open_loop=m.open_loop,
        number=saved.number,
        braked=saved.braked,
        bandwidth_hz=saved.bandwidth_hz,
        damping=saved.damping,
        fired=saved.fired,
    )
    write_json(directory / f"plant-{m.ticks:015d}-{saved.number:06d}.json", content.model_dump())
    for old in sorted(directory.glob("plant-*.json"))[:-2]:  # a kill may come while the last one is being written
        old.unlink(missing_ok=True)


def load(directory: Path, point_id: str) -> Saved:
    """The checkpoint of a point; raises `DriveRefused` where there is none that can be used."""
    for path in sorted(directory.glob("plant-*.json"), reverse=True):
        try:
            content = _Checkpoint.model_validate(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, ValidationError):
            continue  # a torn file is as good as none: the other one is read
        if content.point_id == point_id and len(content.state) == layout.STATE_LENGTH:
            memory = Memory(
                np.array(content.state),
                content.ticks,
                content.base_s,
                content.angle_rad,
                content.base_v,
                content.open_loop,
            )
            return Saved(memory, content.number, content.braked, content.bandwidth_hz, content.damping, content.fired)
    raise DriveRefused(f"{directory}: no state of the plant after point {point_id!r}")


def misalignment(directory: Path) -> float | None:
    """True minus believed electrical angle of the rotor at rest after the last point [rad]; None where none is kept."""
    for path in sorted(directory.glob("plant-*.json"), reverse=True):
        try:
            content = _Checkpoint.model_validate(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, ValidationError):
            continue
        return math.remainder(content.state[layout.ANCHOR] - content.angle_rad, 2.0 * math.pi)
    return None
