"""Whole runs on the reference firmware: what is found is what its motor is, and the map of `demo` is to be trusted."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.plugins.wire.firmware.built import Board, build, host_board, tool
from tests.support.processes import FLUXBENCH, start_fluxbench, wait_until
from tests.support.tiny import STAGES, run_tiny, tiny_file

PATIENT = "-DFB_WATCHDOG_S=10.0f"
"""A process that compiles its kernels while it measures beats late."""
RESISTANCE_OHM = 4.4
"""Of boards/motor/motor.h; the nameplate says 4.25."""
PAGE = Path(__file__).parents[4] / "docs" / "firmware.md"
SIXTEEN_BITS = f"-D_GNU_SOURCE -include {Path(__file__).with_name('octets.h')} -Wno-error=conversion {PATIENT}"


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    with host_board(build(tmp_path / "firmware", "host", "-DFB_WATCHDOG_S=2.0f"), tmp_path, 20.0) as running:
        yield running


def drive_at(board: Board) -> dict[str, Any]:
    return {"name": "serial", "port": board.port, "telemetry_period_s": 0.15}


def require_known_motor(run: Path) -> None:
    found = json.loads((run / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(RESISTANCE_OHM, rel=2e-3)


@pytest.mark.slow
def test_a_run_on_the_firmware_finds_its_motor(tmp_path: Path) -> None:
    with host_board(build(tmp_path / "firmware", "host", PATIENT), tmp_path, 20.0) as board:
        result = run_tiny(tmp_path, drive=drive_at(board))
    assert result.outcome.ending == "finished", result.outcome.reason
    require_known_motor(tmp_path / "run")


@pytest.mark.slow
def test_it_runs_alike_where_a_char_has_sixteen_bits(tmp_path: Path) -> None:
    program = build(tmp_path / "firmware", "host", SIXTEEN_BITS)
    with host_board(program, tmp_path, 20.0) as board:
        result = run_tiny(tmp_path, drive=drive_at(board))
    assert result.outcome.ending == "finished", result.outcome.reason
    require_known_motor(tmp_path / "run")


SAFE = ("--quiet", "--unattended", "I have made the bench safe")


@pytest.mark.slow
@pytest.mark.parametrize("killed", [True, False], ids=["host killed", "firmware stopped"])
def test_either_end_lost_leaves_it_safe_and_the_run_goes_on_later(board: Board, tmp_path: Path, killed: bool) -> None:
    procedure = tiny_file(tmp_path, drive=drive_at(board), stages=[s for s in STAGES if s["kind"] != "estimate"])
    process = start_fluxbench("run", procedure, "--out", tmp_path / "run", *SAFE)
    wait_until(lambda: list((tmp_path / "run" / "captures").glob("*")) != [])
    if killed:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        time.sleep(2.5)
    else:
        board.send(signal.SIGSTOP)
        time.sleep(2.5)
        board.send(signal.SIGCONT)
        _, errors = process.communicate()
        assert process.returncode == 3, errors
    assert "faulted" in probed(board)
    resumed = start_fluxbench("resume", tmp_path / "run", *SAFE)
    _, errors = resumed.communicate()
    assert resumed.returncode == 0, errors


def probed(board: Board) -> str:
    done = subprocess.run([FLUXBENCH, "probe", "--serial", board.port], capture_output=True, text=True)
    return next(line for line in done.stdout.splitlines() if line.split()[:1] == ["now"])


@pytest.mark.slow
def test_the_page_s_three_commands_end_in_a_usable_map(tmp_path: Path) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm", "make"):
        tool(name)
    commands = re.findall(r"^## Three commands\n\n(.*?)\n\n", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)[0]
    make, machine, run = (line.strip() for line in commands.splitlines())
    shell = shutil.which("bash")
    assert shell is not None
    script = "\n".join(
        ("set -e", f'fluxbench() {{ {FLUXBENCH} "$@"; }}', make, machine, "trap 'kill $!' EXIT", "sleep 2")
    )
    script += f"\n{run} --out run --quiet --set drive.telemetry_period_s=0.15"
    done = subprocess.run([shell, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stdout + done.stderr
    require_known_motor(tmp_path / "run")
    assert json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())["usable"]
