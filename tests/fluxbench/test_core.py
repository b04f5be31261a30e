"""The core measures, estimates and diagnoses without any extra; what needs one says in a line how to have it."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from orchestrator.extras import EXTRAS

ROOT = Path(__file__).parents[2]
BEGIN = "from tests.support.without_extras import remove_extras; remove_extras()\n"

IMPORT_ALL = """
import importlib
import sys
from importlib.machinery import PathFinder
from pathlib import Path
from tests.support.without_posix import own_modules, remove_posix

remove_posix()
refused = []
for name in own_modules(Path.cwd()):
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        refused.append(name)
print(*refused, sep="\\n")
sys.meta_path[:] = [PathFinder if isinstance(finder, PathFinder) else finder for finder in sys.meta_path]
for name in refused:
    importlib.import_module(name)
"""
"""All modules without the extras, and those that need them with them again; both without what Windows lacks."""

MEASURE = """
import sys
from pathlib import Path
import fluxbench
from tests.support.tiny import STAGES, tiny_procedure

folder = Path(sys.argv[1])
stages = [*STAGES, {"kind": "diagnose", "rounds": 0}]
run = fluxbench.run(tiny_procedure(folder, stages=stages), out=folder / "run")
fluxbench.estimate(run.path)
fluxbench.export(run.path)
"""

COMMAND = """
import sys
from orchestrator.interface.cli import main

main()
"""


def without_extras(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BEGIN + program, *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.long
def test_all_is_imported_without_posix_and_all_but_the_viewer_the_page_and_the_kits_without_extras() -> None:
    done = without_extras(IMPORT_ALL)
    assert done.returncode == 0, done.stderr
    refused = done.stdout.split()
    assert any(name.startswith("plugins.streams.rerun") for name in refused), "the extras are there all the same"
    rest = ("orchestrator.testing", "plugins.commands.serve", "plugins.streams.rerun")
    assert not [name for name in refused if not name.startswith(rest)]


@pytest.mark.long
@pytest.mark.slow
def test_a_motor_is_measured_estimated_diagnosed_and_exported_without_extras(tmp_path: Path) -> None:
    done = without_extras(MEASURE, str(tmp_path))
    assert done.returncode == 0, done.stderr
    made = {file.name for file in (tmp_path / "run").rglob("*")}
    assert {"estimates.json", "export", "model.json"} <= made
    assert not {"report.html", "view.rrd"} & made


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (["report", "tests/data/pm400-reduced"], "report"),
        pytest.param(["view", "tests/data/pm400-reduced"], "viewer", marks=pytest.mark.slow),
        (["serve"], "serve"),
        pytest.param(["run", "demo", "--view"], "viewer", marks=pytest.mark.slow),
    ],
)
def test_a_command_that_needs_an_extra_says_in_one_line_how_to_have_it(
    words: list[str], extra: str, tmp_path: Path
) -> None:
    out = ["--out", str(tmp_path / "out")] if words[0] in ("report", "run") else []
    done = without_extras(COMMAND, *words, *out)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.rstrip().endswith(f"this needs the extra `{extra}`: pip install 'fluxbench[{extra}]'")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_brings_the_modules_that_its_line_speaks_of(extra: str) -> None:
    asked_for = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"][extra]
    owners = packages_distributions()
    for module in EXTRAS[extra]:
        assert any(line.startswith(tuple(owner.lower() for owner in owners[module])) for line in asked_for)
