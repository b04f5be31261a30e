"""A servo of small inductance behind a bridge that switches, whose currents are read beside the turning point."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.diagnosis import diagnose_recording
from orchestrator.recording import open_recording
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from tests.plugins.estimators.test_plants import run

SERVO = Path(__file__).parents[3] / "docs" / "motors" / "servo-48v.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("offset_us", [0.0, 3.0, -3.0])
def test_a_reading_beside_the_turning_point_is_reported_from_the_ripple(offset_us: float, tmp_path: Path) -> None:
    offset = f"drive.plant.switching.sampling_offset_s={1e-6 * offset_us:g}"
    run(tmp_path / "run", ("drive.plant.inverter=switched", "drive.plant.effects={}", offset), motor=SERVO)
    library = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
    found = diagnose_recording(open_recording(tmp_path / "run"), library, out=tmp_path)
    assert [effect.name for effect in found.report.effects] == (["sampling_offset"] if offset_us else [])
    assert found.report.verdict == ("explained" if offset_us else "clean")
    for effect in found.report.effects:
        found_s = effect.parameters["offset_s"].value
        assert found_s is not None
        assert 1e6 * found_s == pytest.approx(offset_us, rel=0.03)
