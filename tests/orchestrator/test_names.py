"""The orchestrator knows kinds of plugins, and none of them by its name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import orchestrator
from orchestrator.registry.plugins import PluginKind, installed
from protocols import SegmentStage

ROOT = Path(orchestrator.__file__).parent
STAGES = {stage.value for stage in SegmentStage}
"""Kinds of stage that estimators are named after: outside the rooms of estimators these words mean the stage."""


def strings(text: str) -> Iterator[str]:
    """Every string in a module that is neither a docstring nor in one."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_no_estimator_is_spelt_out() -> None:
    names = {info.name for info in installed(PluginKind.ESTIMATORS)}
    assert names - STAGES
    for file in sorted(ROOT.rglob("*.py")):
        forbidden = names if file.parent.name == "estimation" else names - STAGES
        text = file.read_text(encoding="utf-8")
        if any(name in text for name in forbidden):  # most need not be parsed
            assert not forbidden & set(strings(text)), file.relative_to(ROOT)
