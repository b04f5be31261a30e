"""A recording of voltage steps alone, of a plant that the diagnosis has never seen: named is what is wrong with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from orchestrator.diagnosis import Diagnosis, diagnose_recording
from orchestrator.recording import open_recording
from plugins.effects.inverter import DeviceDrop
from plugins.effects.iron import EddyCurrents
from plugins.effects.sensors import CurrentGainMismatch
from plugins.effects.timing import VoltageDelay
from protocols import Effect
from tests.blind.hidden import draw_case
from tests.blind.stepping import record_steps, usual

LIBRARY: list[Effect] = [DeviceDrop(), EddyCurrents(), CurrentGainMismatch(), VoltageDelay()]


def diagnosed(folder: Path, **wrong: Any) -> Diagnosis:
    bench = draw_case("clean", 1, 7).bench
    plan = usual(bench, 60.0, 0.06)
    path = record_steps(replace(bench, plant=bench.plant._replace(**wrong)), plan, folder / "steps")
    return diagnose_recording(open_recording(path), LIBRARY)


def test_a_healthy_plant_is_clean(tmp_path: Path) -> None:
    assert diagnosed(tmp_path).report.verdict == "clean"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "name", "size"),
    [
        ({"drop_v": 1.0, "drop_a": 0.05}, "device_drop", 1.0),
        ({"gain_a": 1.01}, "current_gain_mismatch", 0.01),
        ({"delay_samples": 0.3}, "voltage_delay", 3e-5),
    ],
    ids=["drop", "gain", "lag"],
)
def test_what_was_planted_is_named_with_its_size(
    wrong: dict[str, float], name: str, size: float, tmp_path: Path
) -> None:
    report = diagnosed(tmp_path, **wrong).report
    assert report.verdict == "explained"
    found = report.effects[0]
    assert found.name == name
    assert next(iter(found.parameters.values())).value == pytest.approx(size, rel=0.06)
