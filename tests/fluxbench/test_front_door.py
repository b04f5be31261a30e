"""`import fluxbench`: light, complete, and the same names for a type checker as at runtime."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import fluxbench
from tests.support.processes import called

ROOT = Path(__file__).parents[2]


def test_the_import_brings_in_nothing_heavy() -> None:
    code = "import sys, fluxbench; print(sorted({name.partition('.')[0] for name in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = ast.literal_eval(done.stdout)
    assert "fluxbench" in loaded
    assert not {"numpy", "pydantic", "protocols", "orchestrator", "plugins", "xarray"} & set(loaded)


def test_every_name_is_there() -> None:
    for name in dir(fluxbench):
        assert getattr(fluxbench, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'diagnos'"):
        _ = fluxbench.diagnos


def test_a_type_checker_sees_the_names_that_there_are() -> None:
    tree = ast.parse((ROOT / "fluxbench" / "__init__.py").read_text(encoding="utf-8"))
    guarded = next(node for node in tree.body if isinstance(node, ast.If))
    declared = {
        alias.asname: node.module for node in guarded.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert declared == fluxbench._HOMES


def test_the_module_is_the_command_line() -> None:
    done = subprocess.run([sys.executable, "-m", "fluxbench", "procedures"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout == called("procedures").stdout
