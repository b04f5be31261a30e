"""What Windows lacks is needed nowhere: all modules are imported, and a motor is measured, without POSIX."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("config", "discovery", "estimation", "experiment_design", "flux_maps", "importing", "recording", "runs")

IMPORT_ALL = """
import importlib
from pathlib import Path
from tests.support.without_posix import own_modules, remove_posix

remove_posix()
for name in own_modules(Path.cwd()):
    importlib.import_module(name)
"""

MEASURE = """
import sys
from pathlib import Path
import numpy as np
from tests.support.without_posix import remove_posix

remove_posix()
from orchestrator.importing import import_files
from orchestrator.interface.cli import main
from tests.support.tiny import run_tiny
import fluxbench

folder = Path(sys.argv[1])
run = run_tiny(folder).path
fluxbench.estimate(run)
fluxbench.export(run, folder / "export")
sys.argv = ["fluxbench", "report", str(run), "--out", str(folder / "report.html")]
main()
"""


def finished(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_every_module_is_imported_without_posix() -> None:
    done = finished(IMPORT_ALL)
    assert done.returncode == 0, done.stderr


def test_a_motor_is_measured_estimated_exported_and_reported_without_posix(tmp_path: Path) -> None:
    done = finished(MEASURE, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report.html").stat().st_size > 10_000
