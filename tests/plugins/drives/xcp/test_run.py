"""A whole procedure on an ECU, and what becomes of it where the host is killed."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyxcp", reason="the XCP master is an optional extra")

from tests.plugins.drives.xcp.built import Ecu, build, running
from tests.support.processes import called, start_fluxbench, wait_until
from tests.support.tiny import STAGES, run_tiny, tiny_file

PATIENT = 300_000
"""Ticks: a process that compiles its kernels while it measures beats late."""
RESISTANCE_OHM = 4.4
"""Of boards/motor/motor.h; the nameplate says 4.25."""
SAFE = ("--quiet", "--unattended", "I have made the bench safe")


def drive_at(ecu: Ecu) -> dict[str, Any]:
    return {"name": "xcp", **ecu.options.model_dump(exclude_defaults=True)}


@pytest.mark.slow
@pytest.mark.long
def test_a_procedure_runs_to_its_map_and_finds_the_motor(tmp_path: Path) -> None:
    with running(build(tmp_path / "built", PATIENT), tmp_path) as ecu:
        result = run_tiny(tmp_path, drive=drive_at(ecu))
        assert not ecu.gates_are_on
    assert result.outcome.ending == "finished", result.outcome.reason
    found = json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(RESISTANCE_OHM, rel=2e-3)


@pytest.mark.slow
def test_a_host_that_is_killed_leaves_the_gates_off_and_the_run_goes_on_later(tmp_path: Path) -> None:
    with running(build(tmp_path / "built", 10_000), tmp_path) as ecu:
        stages = [stage for stage in STAGES if stage["kind"] != "estimate"]
        procedure = tiny_file(tmp_path, drive=drive_at(ecu), stages=stages)
        process = start_fluxbench("run", procedure, "--out", tmp_path / "run", *SAFE)
        wait_until(lambda: list((tmp_path / "run" / "captures").glob("*")) != [])
        assert ecu.gates_are_on
        process.send_signal(signal.SIGKILL)
        process.communicate()
        wait_until(lambda: not ecu.gates_are_on, 1.2)
        resumed = start_fluxbench("resume", tmp_path / "run", *SAFE)
        _, errors = resumed.communicate()
        assert resumed.returncode == 0, errors


def test_the_routine_is_written_and_a_config_that_was_filled_in_stays(tmp_path: Path) -> None:
    assert called("xcp", tmp_path / "ecu").returncode == 0
    config = tmp_path / "ecu" / "fluxbench_config.h"
    config.write_text("mine")
    done = called("xcp", tmp_path / "ecu")
    assert [Path(line).name for line in done.stdout.split()] == ["fluxbench_xcp.h", "fluxbench_xcp.c"]
    assert config.read_text() == "mine"
    (tmp_path / "file").touch()
    assert called("xcp", tmp_path / "file").returncode == 2
