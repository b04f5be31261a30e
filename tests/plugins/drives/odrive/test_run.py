"""The procedure of docs/odrive.md on an emulated board: its resistance, and what a killed host leaves."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest
import yaml

from orchestrator.config import load_procedure
from orchestrator.engine import SAFE_BENCH_WORDS, AbsentOperator, Interrupts, RunServices, start_run
from tests.plugins.drives.odrive.emulator import on_a_line, on_tcp
from tests.support.processes import start_fluxbench, wait_until

PAGE = Path(__file__).parents[4] / "docs" / "odrive.md"
SAFE = ("--quiet", "--unattended", "I have made the bench safe")


def procedure_at(port: str, folder: Path, watchdog_s: float) -> Path:
    found = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None, f"{PAGE} shows no procedure"
    document: dict[str, Any] = yaml.safe_load(found[1])
    document["drive"].update(port=port, watchdog_s=watchdog_s)
    file = folder / "procedure.yaml"
    file.write_text(yaml.safe_dump(document), encoding="utf-8")
    return file


@pytest.mark.slow
def test_the_pages_procedure_finds_the_resistance(tmp_path: Path) -> None:
    with on_tcp() as (board, port):
        procedure = load_procedure(str(procedure_at(port, tmp_path, 10.0)))
        result = start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts()))
        assert not board.armed
    assert result.outcome.ending == "finished", result.outcome.reason
    found = json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(board.resistance_ohm, rel=0.01)


@pytest.mark.slow
def test_a_host_that_is_killed_leaves_the_axis_disarmed(tmp_path: Path) -> None:
    with on_a_line() as (board, port):
        process = start_fluxbench("run", procedure_at(port, tmp_path, 1.0), "--out", tmp_path / "run", *SAFE)
        wait_until(lambda: board.armed)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        wait_until(lambda: not board.armed, 2.5)
