"""The procedure of docs/vesc.md on an emulated board: resistance, inductances, and what a killed host leaves."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from orchestrator.analysis import demodulate, invert
from orchestrator.config import load_procedure
from orchestrator.engine import SAFE_BENCH_WORDS, AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.recording import open_recording
from protocols import SegmentStage
from tests.plugins.drives.vesc.emulator import Firmware, on_a_line, on_tcp
from tests.support.processes import start_fluxbench, wait_until

PAGE = Path(__file__).parents[4] / "docs" / "vesc.md"
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
def test_the_pages_procedure_finds_resistance_and_inductances(tmp_path: Path) -> None:
    with on_tcp() as (firmware, port):
        procedure = load_procedure(str(procedure_at(port, tmp_path, 10.0)))
        result = start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts()))
        assert not firmware.running
        motor, angle = firmware.motor, 0.7
    assert result.outcome.ending == "finished", result.outcome.reason
    found = json.loads((tmp_path / "run" / "results" / "estimates.json").read_text())
    assert found["resistance"]["value_ohm"] == pytest.approx(motor.resistance_ohm, rel=0.01)
    recording = open_recording(tmp_path / "run")
    ripples = [
        demodulate(recording.load(segment), segment.rotor_angle_rad, voltage_delay_samples=0.5)
        for segment in recording.segments(SegmentStage.INJECTION)
    ]
    believed = recording.segments(SegmentStage.INJECTION)[0].rotor_angle_rad
    mean = invert(ripples).matrix.mean(axis=0)
    off = np.exp(1j * (angle - believed))
    turn = np.array([[off.real, -off.imag], [off.imag, off.real]])
    true = turn @ np.diag([motor.ld_h, motor.lq_h]) @ turn.T
    assert mean == pytest.approx(true, rel=0.02, abs=0.02 * motor.ld_h)


@pytest.mark.slow
def test_a_host_that_is_killed_leaves_the_bridge_off(tmp_path: Path) -> None:
    with on_a_line() as (firmware, port):
        process = start_fluxbench("run", procedure_at(port, tmp_path, 1.0), "--out", tmp_path / "run", *SAFE)
        wait_until(lambda: firmware.running)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        wait_until(lambda: not firmware.running, 2.5)


def test_a_voltage_that_the_bus_cannot_give_ends_the_run_with_the_bridge_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("plugins.drives.vesc._board.CONSOLE_PERIOD_S", 0.04)
    monkeypatch.setattr("tests.plugins.drives.vesc.emulator.DEAF_S", 0.03)
    tell = Firmware._tell

    def lie(firmware: Firmware, mask: int) -> None:
        """2.1 MV along d, on a bus of 24 V."""
        firmware._sums[2] = 2.147e6 * max(firmware._count, 1) if firmware.running else 0.0
        tell(firmware, mask)

    monkeypatch.setattr(Firmware, "_tell", lie)
    with on_tcp() as (firmware, port):
        path = procedure_at(port, tmp_path, 10.0)
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        document["stages"] = [stage for stage in document["stages"] if stage["kind"] == "resistance"][:1]
        path.write_text(yaml.safe_dump(document), encoding="utf-8")
        services = RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts())
        result = start_run(load_procedure(str(path)), tmp_path / "run", services)
        assert not firmware.running
    assert result.outcome.ending == "faulted"
    expected = r"wrong_data: resistance-000: 2\.147e\+06 V at the motor, from a bus of 24 V"
    assert re.search(expected, result.outcome.reason), result.outcome.reason
