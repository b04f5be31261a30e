"""Recordings of one motor and drive become one; for other recordings the error names the field that differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.importing import merge_recordings
from orchestrator.interface.cli._running import run_app
from orchestrator.recording import open_recording
from protocols import InputError
from tests.orchestrator.importing.benches import RATE, Bench


def test_two_recordings_become_one(bench: Bench) -> None:
    bench.run("one")
    bench.columns["ia"] = bench.columns["ia"] + 1e-3
    bench.run("two")
    folder = bench.folder
    assert run_app(["import", "--merge", str(folder / "one"), str(folder / "two"), "--out", str(folder / "both")]) == 0
    merged = open_recording(folder / "both")
    assert [(s.id, s.start_s) for s in merged.segments()] == [
        ("resistance-000", 0.0),
        ("resistance-000.2", pytest.approx(400 / RATE)),
    ]
    for capture, name in zip(map(merged.load, merged.segments()), ("one", "two"), strict=True):
        np.testing.assert_array_equal(capture.i_ab, bench.captures(name)[0].i_ab)


def test_another_motor_is_refused_by_its_field(bench: Bench) -> None:
    bench.run("one")
    bench.mapping["motor"]["pole_pairs"] = 4
    bench.run("two")
    paths = [bench.folder / "one", bench.folder / "two"]
    with pytest.raises(InputError, match=r"two: motor.pole_pairs: 4, but .*one has 2"):
        merge_recordings(paths, bench.folder / "both")
    with pytest.raises(InputError, match="expected two recordings or more, got 1"):
        merge_recordings(paths[:1], Path("both"))
    assert not (bench.folder / "both").exists()
