"""Recordings to test on: a small one made of noise, and captures to make more of."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.recording import SegmentWriter, capture_path, write_manifest
from protocols import Capture, DriveRecord, Manifest, Motor, Segment

RATE = 1e4


@pytest.fixture(scope="session")
def make_capture() -> Callable[..., Capture]:
    def make(start_s: float = 0.0, n: int = 100, *, dtype: str = "f4", seed: int = 0, phases: bool = False) -> Capture:
        rng = np.random.default_rng(seed)
        return Capture(
            start_s=start_s,
            sampling_frequency_hz=RATE,
            i_ab=rng.normal(size=(n, 2)).astype(dtype),
            v_ab=rng.normal(size=(n, 2)).astype(dtype),
            v_dc=np.full(n, 540.0, dtype),
            i_abc=rng.normal(size=(n, 3)).astype(dtype) if phases else None,
            temperature_c=np.full(n, 20.0, dtype) if phases else None,
        )

    return make


@pytest.fixture
def make_recording(tmp_path: Path, make_capture: Callable[..., Capture]) -> Callable[..., Path]:
    """Write a recording of `segments` short segments, in reversed order in its manifest; returns its directory."""

    def make(segments: int = 2, *, with_checksum: bool = True, **capture: object) -> Path:
        directory = tmp_path / "recording"
        listed = []
        for k in range(segments):
            segment_id = f"resistance-{k:03d}"
            with SegmentWriter(directory, segment_id) as writer:
                writer.append(make_capture(start_s=1.0 + k, seed=k, **capture))
                written = writer.finish()
            listed.append(
                Segment(
                    id=segment_id,
                    stage="resistance" if k % 2 == 0 else "injection",
                    start_s=written.start_s,
                    samples=written.samples,
                    settings={"pwm_frequency_hz": 2e4, "anchor": True},
                    sha256=written.sha256 if with_checksum else None,
                )
            )
        manifest = Manifest(
            format="fluxbench-recording",
            version=1,
            name="noise",
            created="2026-01-01T00:00:00Z",
            motor=Motor(name="m", pole_pairs=2),
            drive=DriveRecord(name="d", sampling_frequency_hz=RATE, dc_bus_voltage_v=540.0),
            segments=tuple(reversed(listed)),
        )
        write_manifest(directory, manifest)
        return directory

    return make


@pytest.fixture
def sha256_of() -> Callable[[Path, str], str]:
    return lambda directory, segment_id: hashlib.sha256(capture_path(directory, segment_id).read_bytes()).hexdigest()
