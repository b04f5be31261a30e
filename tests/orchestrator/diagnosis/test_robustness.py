"""Recordings that are not ideal: the diagnosis stays quiet, says what it can no longer tell apart, or refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.diagnosis import diagnose_recording
from orchestrator.recording import Recording, open_recording, write_manifest
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents
from plugins.effects.resistance import SkinEffect, WindingHeating
from plugins.effects.sensors import CurrentOffset
from plugins.effects.timing import VoltageDelay
from protocols import Effect, NotMeasuredError, Segment, SegmentStage

LIBRARY: list[Effect] = [
    DeadTime(),
    DeviceDrop(),
    VoltageBias(),
    CurrentOffset(),
    RotorMisalignment(),
    EddyCurrents(),
    SkinEffect(),
    WindingHeating(),
    VoltageDelay(),
]


def _with(recording: Recording, directory: Path, wanted: Callable[[Segment], bool]) -> Recording:
    """The same recording without some of its segments."""
    directory.mkdir()
    (directory / "captures").symlink_to(recording.path / "captures")
    kept = tuple(s for s in recording.manifest.segments if wanted(s))
    write_manifest(directory, recording.manifest.model_copy(update={"segments": kept}))
    return open_recording(directory)


@pytest.mark.slow
def test_correlated_noise_is_no_effect(correlated: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(correlated, LIBRARY, out=tmp_path).report
    assert report.verdict == "clean"
    assert report.ladder[0].chi2 == pytest.approx(1.0, abs=0.08)
    assert any("correlated" in note for note in report.notes)


@pytest.mark.slow
def test_jitter_is_no_effect(jittering: Recording, tmp_path: Path) -> None:
    report = diagnose_recording(jittering, LIBRARY, out=tmp_path).report
    assert report.verdict == "clean"
    # Jitter scatters the readings with the ripple's slope, which is not the same at all points as it is taken to be.
    assert report.ladder[0].chi2 == pytest.approx(1.0, abs=0.1)
    assert any("under injection" in note for note in report.notes)


def test_injection_alone_is_enough_to_be_clean(clean: Recording, tmp_path: Path) -> None:
    only = _with(clean, tmp_path / "only", lambda s: s.stage is SegmentStage.INJECTION)
    report = diagnose_recording(only, LIBRARY).report
    assert report.verdict == "clean"
    assert any("gates-off" in note for note in report.notes)
    assert any("no sweep" in note for note in report.notes)


@pytest.mark.slow
def test_dead_time_without_a_sweep_is_named_with_its_twin(with_dead_time: Recording, tmp_path: Path) -> None:
    parts = (SegmentStage.RESISTANCE, SegmentStage.INJECTION)
    report = diagnose_recording(
        _with(with_dead_time, tmp_path / "part", lambda s: s.stage in parts), LIBRARY[:5]
    ).report
    assert {report.effects[0].name, *report.effects[0].twins} == {"dead_time", "device_drop"}
    assert report.effects[0].parameters["voltage_v"].value == pytest.approx(0.8, rel=0.03)


def test_too_few_holds_are_refused(clean: Recording, tmp_path: Path) -> None:
    holds = [s.id for s in clean.manifest.segments if s.stage is SegmentStage.RESISTANCE][:3]
    few = _with(clean, tmp_path / "few", lambda s: s.id in holds)
    with pytest.raises(NotMeasuredError, match="too few"):
        diagnose_recording(few, LIBRARY)
