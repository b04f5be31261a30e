"""What a stage is called is written in its own module and nowhere else."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from orchestrator.stages import installed_stages
from protocols import ExcitationKind

ROOT = Path(__file__).parents[3]
ROOMS = (
    "orchestrator/config",
    "orchestrator/engine",
    "orchestrator/formatting",
    "orchestrator/runs",
    "orchestrator/interface/scaffolding",
    "orchestrator/stages",
    "plugins/streams",
)
OTHERS = {"operator", "resistance", *get_args(ExcitationKind)}
"""Words that mean something else as well: who answers, an estimate, an excitation."""


def words(room: str) -> Iterator[tuple[str, str]]:
    for file in (ROOT / room).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{file.relative_to(ROOT)}:{node.lineno}", node.value


def test_no_room_spells_a_stage_s_kind_or_state() -> None:
    stages = installed_stages()
    states = {s.name for stage in stages for s in (*stage.working, *([stage.measuring] if stage.measuring else []))}
    names = {stage.name for stage in stages} | states
    assert {"lock_check", "sweeping_injection", "comparing"} <= names
    spelled = [place for room in ROOMS for place, word in words(room) if word in names - OTHERS]
    assert spelled == []
