"""A procedure with a secret, a drive that says what it can, and a run of the two."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.recording import SegmentWriter
from orchestrator.runs import RunDirectory
from protocols import Capabilities, Capture, PointDone, Procedure, Segment


@pytest.fixture
def procedure() -> Procedure:
    return Procedure.model_validate(
        {
            "format": "fluxbench-procedure",
            "version": 1,
            "name": "secretive",
            "seed": 7,
            "motor": {"name": "m", "pole_pairs": 2},
            "drive": {"name": "simulated", "max_current_a": 9, "plant": {"resistance_ohm": 4.321, "effects": {}}},
            "limits": {"current_a": 5.0, "voltage_v": 100.0},
            "stages": [{"kind": "gates_off"}, {"kind": "estimate", "estimators": ["classical"]}],
        }
    )


@pytest.fixture
def capabilities() -> Capabilities:
    return Capabilities(
        name="simulated",
        sampling_frequency_hz=1e4,
        pwm_frequency_hz=8e3,
        pwm_frequencies_hz=(8e3, 16e3),
        dc_bus_voltage_v=540.0,
        voltage_delay_samples=1.0,
        max_current_a=9.0,
        max_voltage_v=300.0,
        excitations=frozenset({"gates_off"}),
        watchdog_s=0.2,
    )


@pytest.fixture
def run(tmp_path: Path, procedure: Procedure, capabilities: Capabilities) -> RunDirectory:
    return RunDirectory.create(tmp_path / "runs" / "r1", procedure, capabilities, sealed=["plant"])


@pytest.fixture
def measure() -> Callable[..., PointDone]:
    """Write a segment's capture into a run and return the message that records it as done."""

    def write(run: RunDirectory, segment_id: str, start_s: float, n: int = 50) -> PointDone:
        capture = Capture(
            start_s=start_s,
            sampling_frequency_hz=1e4,
            i_ab=np.full((n, 2), 0.5, np.float32),
            v_ab=np.zeros((n, 2), np.float32),
            v_dc=np.full(n, 540.0, np.float32),
        )
        with SegmentWriter(run.path, segment_id) as writer:
            writer.append(capture)
            written = writer.finish()
        return point_done(segment_id, start_s, written.samples, written.sha256)

    return write


def point_done(segment_id: str, start_s: float, samples: int = 50, sha256: str | None = None) -> PointDone:
    segment = Segment(id=segment_id, stage="resistance", start_s=start_s, samples=samples, sha256=sha256)
    return PointDone(
        id=segment_id,
        stage_index=0,
        segment=segment,
        achieved_d_a=0.5,
        achieved_q_a=0.5,
        points_done=1,
        points=2,
        seconds_left=1.0,
    )
