"""What Windows lacks is needed nowhere: a motor is measured without POSIX. test_core.py imports all modules so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = (
    "orchestrator/analysis", "orchestrator/diagnosis", "orchestrator/estimation", "orchestrator/flux_maps",
    "orchestrator/importing", "orchestrator/recording", "plugins/drives/simulated", "plugins/estimators",
    "plugins/streams/report",
)  # fmt: skip
"""Folders of tests that have to pass so."""

MEASURE = """
import sys
from pathlib import Path
from tests.support.without_posix import remove_posix

remove_posix()
from orchestrator.interface.cli import main
from tests.orchestrator.importing.benches import Bench, held_current, phase_log
from tests.support.tiny import run_tiny
import fluxbench

folder = Path(sys.argv[1])
Bench(folder, *phase_log(*held_current())).run()
fluxbench.estimate(folder / "recording")
run = run_tiny(folder).path
fluxbench.estimate(run)
fluxbench.export(run, out=folder / "export")
sys.argv = ["fluxbench", "report", str(run), "--out", str(folder / "report.html")]
main()
"""


def finished(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.long
@pytest.mark.slow
def test_a_motor_is_measured_estimated_exported_and_reported_without_posix(tmp_path: Path) -> None:
    done = finished(MEASURE, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "recording" / "results" / "estimates.json").is_file()
    assert any((tmp_path / "export").iterdir())
    assert (tmp_path / "report.html").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("room", ROOMS)
def test_the_tests_of_a_room_pass_without_posix(room: str) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.support.without_posix"]
    command += ["-m", "not slow and not posix", f"tests/{room}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-5000:]
