"""Whole runs on the emulated drive over the kernel's own buses: they measure what a run in this process measures."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orchestrator.recording import open_recording
from plugins.commands.emulator._command import command
from plugins.drives.simulated import SimulatedOptions
from plugins.drives.simulated.rig import Rig
from protocols import Motor
from tests.socketcan.buses import CLASSIC_BUS, FD_BUS, is_fd
from tests.support.processes import wait_until
from tests.support.tiny import MOTOR, STAGES, run_tiny

MEASURING = [stage for stage in STAGES if stage["kind"] != "estimate"]
PLANT = ("--set", "plant.effects={}", "--set", "plant.sensors.noise_a=0", "--speed", "max", "--watchdog", "10")
"""As the simulated drive has it without options; patient, for the machine may be slow."""
LOSSES = ("--drop", "0.01", "--duplicate", "0.01", "--reorder", "0.01", "--corrupt", "0.0001")
RATED_A, RATED_V = 2.35, 113.0

pytestmark = pytest.mark.timeout(600)


@cache
def means(path: Path) -> dict[str, np.ndarray]:
    """Mean current and voltage of each segment as parts of the rated ones, shape (4,)."""
    recording = open_recording(path)
    found = {}
    for segment in recording.segments():
        capture = recording.load(segment)
        found[segment.id] = np.concatenate((capture.i_ab.mean(axis=0) / RATED_A, capture.v_ab.mean(axis=0) / RATED_V))
    return found


def events(log: Path) -> list[str]:
    """What the emulator has logged so far."""
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    return [str(json.loads(line)["event"]) for line in lines if line.endswith("\n")]


@contextmanager
def emulated(log: Path, *words: str) -> Iterator[None]:
    """The emulator as a process of its own. A fork, for imports take long in a slow machine."""
    process = multiprocessing.get_context("fork").Process(target=command, args=([*words, "--log", str(log)],))
    process.start()
    try:
        wait_until(lambda: "started" in events(log) or not process.is_alive(), 120.0)
        yield
    finally:
        process.terminate()
        process.join(30.0)
        process.kill()


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    folder = tmp_path_factory.mktemp("reference")
    Rig(SimulatedOptions(), Motor(**MOTOR), 1).warm_up()  # what takes long the first time is no reason to trip
    result = run_tiny(folder, drive={"watchdog_s": 120.0}, stages=MEASURING)
    assert result.outcome.ending == "finished", result.outcome.reason
    return means(folder / "run")


@pytest.mark.parametrize(("bus", "losses"), [(CLASSIC_BUS, ()), (FD_BUS, LOSSES)], ids=["classic", "fd-lossy"])
def test_a_run_measures_what_a_run_in_process_does(
    bus: str, losses: tuple[str, ...], in_process: dict[str, np.ndarray], tmp_path: Path
) -> None:
    fd = ("--fd",) if is_fd(bus) else ()
    drive = {
        "name": "can",
        "interface": "socketcan",
        "channel": bus,
        "fd": is_fd(bus),
        "telemetry_period_s": 1.0,
        "answer_timeout_s": 5.0,
    }
    log = tmp_path / "emulator.jsonl"
    with emulated(log, "--can", f"socketcan:{bus}", *fd, *PLANT, *losses):
        result = run_tiny(tmp_path, drive=drive, stages=MEASURING)
        assert result.outcome.ending == "finished", result.outcome.reason
        assert [event for event in events(log) if event in ("armed", "disarmed")][-1] == "disarmed"
    over_bus = means(tmp_path / "run")
    assert over_bus.keys() == in_process.keys()
    for name, expected in in_process.items():
        np.testing.assert_allclose(over_bus[name], expected, atol=5e-3, err_msg=name)
