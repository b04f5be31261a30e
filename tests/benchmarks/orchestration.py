"""What the engine adds to each point beyond the drive's own time: a drive that answers at once shows it."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from orchestrator.config import make_plan
from orchestrator.engine import AbsentOperator, Commissioning, Interrupts, UsedPlugins
from orchestrator.engine._log import RunLog
from orchestrator.engine.streaming import Dispatcher
from orchestrator.recording import SegmentWriter
from orchestrator.runs import RunDirectory
from protocols import Capabilities, Capture, DriveSetup, DriveState, Excitation, Limits, NoOptions, Telemetry
from tests.support.tiny import tiny_procedure

POINTS, ROWS, RATE = 400, 2000, 10_000.0
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where an fsync costs nothing, so that the disk's is not counted as the engine's."""


class InstantDrive:
    """Hands out the same block whatever it is requested."""

    name: ClassVar[str] = "instant"
    Options: ClassVar[type[BaseModel]] = NoOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, setup: DriveSetup | None = None) -> None:
        rng = np.random.default_rng(1)
        self._i_ab = rng.normal(size=(ROWS, 2)).astype(np.float32)
        self._v_dc = np.full(ROWS, 540.0, dtype=np.float32)
        self._start_s = 0.0

    def connect(self) -> Capabilities:
        return Capabilities(
            name=self.name,
            sampling_frequency_hz=RATE,
            pwm_frequency_hz=RATE,
            pwm_frequencies_hz=(RATE,),
            dc_bus_voltage_v=540.0,
            max_current_a=10.0,
            max_voltage_v=300.0,
            excitations=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
            watchdog_s=0.2,
        )

    def block(self) -> Capture:
        self._start_s += ROWS / RATE
        return Capture(
            start_s=self._start_s,
            sampling_frequency_hz=RATE,
            i_ab=self._i_ab,
            v_ab=self._i_ab,
            v_dc=self._v_dc,
        )

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        yield self.block()

    def telemetry(self) -> Telemetry:
        return Telemetry(state=DriveState.DISARMED, time_s=0.0, i_d_a=0.0, i_q_a=0.0, v_dc_v=540.0)

    def arm(self, limits: Limits) -> None: ...
    def heartbeat(self) -> None: ...
    def ramp_down(self) -> None: ...
    def disarm(self) -> None: ...
    def clear_fault(self) -> None: ...
    def set_brake(self, engaged: bool) -> None: ...
    def close(self) -> None: ...


def point_s(folder: Path) -> float:
    """Seconds a point takes on a drive that answers at once."""
    points = [[0.001 * k, 0.0] for k in range(POINTS)]
    stage = {"kind": "resistance", "points_a": points, "settle_s": 0.1, "duration_s": ROWS / RATE}
    procedure = tiny_procedure(folder, stages=[stage])
    drive = InstantDrive()
    capabilities = drive.connect()
    run = RunDirectory.create(folder / "run", procedure, capabilities)
    with run.lock():
        log = RunLog(run.journal, Dispatcher({}))
        plan = make_plan(procedure, capabilities)
        job = Commissioning(run, plan, drive, capabilities, UsedPlugins([]), AbsentOperator(), Interrupts(), log)
        begun = time.perf_counter()
        outcome = job.execute()
        spent = time.perf_counter() - begun
    assert outcome.error is None, outcome
    return spent / POINTS


def writing_s(folder: Path) -> float:
    """Seconds that encoding and fsync of one such capture take by themselves."""
    drive = InstantDrive()
    begun = time.perf_counter()
    for k in range(POINTS):
        with SegmentWriter(folder, f"hold-{k:03d}") as writer:
            writer.append(drive.block())
            writer.finish()
    return (time.perf_counter() - begun) / POINTS


def main() -> None:
    points, writings = [], []
    for _ in range(5):
        with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
            points.append(point_s(Path(folder)))
        with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
            writings.append(writing_s(Path(folder)))
    added = statistics.median(p - w for p, w in zip(points, writings, strict=True))
    print(
        f"a point {1e3 * statistics.median(points):.2f} ms, of it writing {1e3 * statistics.median(writings):.2f} ms: "
        f"{1e3 * added:.2f} ms of orchestration, {added / 1e-3:.2f} of the millisecond that is allowed"
    )


if __name__ == "__main__":
    main()
