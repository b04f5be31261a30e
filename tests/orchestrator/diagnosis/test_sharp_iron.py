"""A published map of a motor whose bridges saturate sharply, commissioned by the demo's plan: what is stated of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from orchestrator.diagnosis import diagnose_recording
from orchestrator.recording import open_recording
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from plugins.drives.simulated import map_motor
from tests.plugins.estimators.test_plants import errors, rms, run, truth_of

DEAD_V = 1.6
USUAL: dict[str, Any] = {
    "dead_time": {"voltage_v": DEAD_V},
    "winding_heating": {"rise_per_watt": 0.0012, "time_constant_s": 300.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("effects", [{}, USUAL])
def test_detail_of_a_real_motors_map_is_taken_for_no_effect(effects: dict[str, Any], tmp_path: Path) -> None:
    name = "ipm-femm-60c"
    plant = {"magnetics": {"kind": "map", "name": name}, "sensors": {"noise_a": 0.25}, "effects": effects}
    overlay = tmp_path / "motor.yaml"
    limits = {"current_a": 178.0, "voltage_v": 160.0, "duration_s": 900.0, "energy_j": 1e8}
    motor = map_motor(name).model_dump(exclude_none=True)
    drive = {"name": "simulated", "plant": plant}
    overlay.write_text(yaml.safe_dump({"motor": motor, "limits": limits, "drive": drive}, allow_unicode=True))
    procedure = run(tmp_path / "run", motor=overlay)
    library = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
    found = diagnose_recording(open_recording(tmp_path / "run"), library, model="saturated", out=tmp_path)
    assert found.report.verdict == ("explained" if effects else "clean")
    # One PWM frequency does not part dead time from the devices' drop.
    named = {alike for effect in found.report.effects for alike in (effect.name, *effect.twins)}
    assert named <= {"dead_time", "device_drop", "winding_heating"}
    if effects:
        (lost,) = (e for e in found.report.effects if e.name in ("dead_time", "device_drop"))
        assert lost.parameters["voltage_v"].value == pytest.approx(DEAD_V, rel=0.05)
    assert found.delivery is not None
    off, _ = errors(found.delivery.map, truth_of(procedure), procedure.motor)
    assert rms(off) < 1.0
    assert np.median(np.abs(off)) < 0.1
