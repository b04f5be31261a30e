"""A procedure with every stage kind in it that takes a second, and ways to run it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import yaml

from orchestrator.config import load_procedure
from orchestrator.engine import SAFE_BENCH_WORDS, AbsentOperator, Interrupts, RunResult, RunServices, start_run
from orchestrator.runs import RunDirectory
from protocols import Message, Procedure

MOTOR: dict[str, Any] = {
    "name": "400 W test PMSM",
    "pole_pairs": 2,
    "rated_voltage_rms_v": 139.3,
    "rated_current_rms_a": 1.66,
    "rated_torque_nm": 2.12,
    "stator_resistance_ohm": 4.25,
    "d_inductance_h": 0.04325,
    "q_inductance_h": 0.06905,
    "pm_flux_wb": 0.30,
}

STAGES: list[dict[str, Any]] = [
    {"kind": "gates_off", "duration_s": 0.02},
    {"kind": "operator", "prompt": "Release the brake", "answer": "yes", "brake": "release"},
    {"kind": "alignment", "settle_s": 0.5, "duration_s": 0.02},
    {"kind": "operator", "prompt": "Engage the brake", "answer": "yes", "brake": "engage"},
    {"kind": "lock_check", "settle_s": 0.2, "duration_s": 0.2},
    {
        "kind": "resistance",
        "points_a": [[-1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-2.0, 0.0]],
        "settle_s": 0.15,
        "duration_s": 0.05,
    },
    {"kind": "classical", "axes": ["q", "d"], "held_a": [0.0], "amplitude_a": 2.0, "period_s": 0.5, "periods": 1},
    {
        "kind": "injection",
        "points_a": [[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0]],
        "amplitudes_v": [40.0],
        "rotation_hz": 10.0,
        "settle_s": 0.2,
        "duration_s": 0.2,
    },
    {"kind": "estimate"},
]
"""Eight stages; the first six of them need the drive."""


def all_effects_but(*names: str) -> list[str]:
    """What a diagnosis leaves out that is to know these effects alone, and be quick."""
    return sorted(entry.name for entry in entry_points(group="fluxbench.effects") if entry.name not in names)


def tiny_document(
    drive: Mapping[str, Any] | None = None,
    stages: Sequence[dict[str, Any]] | None = None,
    motor: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The procedure as a document; the drive's options, the motor and the limits are put in their places.

    A simulated drive has patience: what is proved with it is no matter of time, and a busy machine beats late.
    """
    chosen = {"name": "simulated", **(drive or {})}
    if chosen["name"] == "simulated":
        chosen.setdefault("watchdog_s", 60.0)
    return {
        "format": "fluxbench-procedure",
        "version": 1,
        "name": "tiny",
        "motor": dict(motor if motor is not None else MOTOR),
        "drive": chosen,
        "limits": dict(limits if limits is not None else {"current_a": 4.5, "voltage_v": 150.0}),
        "stages": list(stages if stages is not None else STAGES),
    }


def tiny_file(folder: Path, **changes: Any) -> Path:
    """`tiny_document` as a file."""
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(tiny_document(**changes), sort_keys=False))
    return path


def tiny_procedure(folder: Path, **changes: Any) -> Procedure:
    """`tiny_document`, loaded."""
    return load_procedure(str(tiny_file(folder, **changes)))


def run_tiny(folder: Path, *, interrupts: Interrupts | None = None, **changes: Any) -> RunResult:
    """Run it in this process without streams; the run directory is `folder`/run."""
    services = RunServices(AbsentOperator(SAFE_BENCH_WORDS), interrupts or Interrupts())
    return start_run(tiny_procedure(folder, **changes), folder / "run", services)


def messages_of(path: Path) -> list[Message]:
    """All that the journal of a run holds."""
    return [record.message for record in RunDirectory.open(path).journal.read()]
