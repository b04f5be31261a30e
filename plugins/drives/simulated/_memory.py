"""Checkpoints of the simulated drive: JSON in the private directory, replaced by rename, two kept."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import suppress
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
    """Content of a checkpoint: the plant's memory, and the rig's settings."""

    memory: Memory
    number: int
    """Number of excitations so far."""
    braked: bool
    bandwidth_hz: float
    damping: float
    fired: tuple[int, ...]


def save(directory: Path, point_id: str, saved: Saved) -> None:
    """Write a checkpoint and remove all but the last two."""
    memory, others = vars(saved.memory), {name: value for name, value in vars(saved).items() if name != "memory"}
    content = _Checkpoint(point_id=point_id, **{**memory, **others, "state": tuple(saved.memory.state.tolist())})
    write_json(directory / f"plant-{content.ticks:015d}-{saved.number:06d}.json", content.model_dump())
    for old in sorted(directory.glob("plant-*.json"))[:-2]:  # the process may die while the last one is written
        old.unlink(missing_ok=True)


def load(directory: Path, point_id: str) -> Saved:
    """The checkpoint of a point; raises `DriveRefused` where there is none."""
    for content in _checkpoints(directory):
        if content.point_id == point_id and len(content.state) == layout.STATE_LENGTH:
            fields = content.model_dump(exclude={"point_id", "state"})
            memory_fields = {name: fields.pop(name) for name in ("ticks", "base_s", "angle_rad", "base_v", "open_loop")}
            return Saved(Memory(np.array(content.state), **memory_fields), **fields)
    raise DriveRefused(f"{directory}: no state of the plant after point {point_id!r}")


def misalignment(directory: Path) -> float | None:
    """True minus believed electrical angle of the rotor at rest after the last point [rad]; None where none is kept."""
    last = next(_checkpoints(directory), None)
    return None if last is None else math.remainder(last.state[layout.ANCHOR] - last.angle_rad, 2.0 * math.pi)


def _checkpoints(directory: Path) -> Iterator[_Checkpoint]:
    """Readable checkpoints, the latest first; incomplete files are skipped."""
    for path in sorted(directory.glob("plant-*.json"), reverse=True):
        with suppress(OSError, ValueError, ValidationError):
            yield _Checkpoint.model_validate(json.loads(path.read_text(encoding="utf-8")))
