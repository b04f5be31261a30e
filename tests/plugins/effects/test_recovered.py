"""What the simulated bench suffers from is found as large as it is, by effects that share no code with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest

from orchestrator.config import load_procedure
from orchestrator.diagnosis import diagnose_recording
from orchestrator.recording import Recording
from plugins.effects.frame import BrakeBacklash, BrakeCompliance, RotorMisalignment
from protocols import DiagnosisReport, Effect
from tests.support.simulated import measure


def diagnosed(effects: dict[str, Any], library: list[Effect], out: Path) -> DiagnosisReport:
    """A quick campaign of the simulated drive with these effects."""
    procedure = load_procedure("quick", overrides=("drive.plant.effects={}",))
    plant = {**procedure.drive.options["plant"], "effects": effects}
    drive = procedure.drive.model_copy(update={"plant": plant})
    recording = measure(procedure.model_copy(update={"drive": drive})).recording
    return diagnose_recording(cast(Recording, recording), library, out=out).report


@pytest.mark.slow
def test_play_in_the_brake(tmp_path: Path) -> None:
    library: list[Effect] = [BrakeBacklash(), BrakeCompliance(), RotorMisalignment()]
    report = diagnosed({"brake_compliance": {"rad_per_nm": 0.0, "backlash_rad": 0.01}}, library, tmp_path)
    assert [e.name for e in report.effects] == ["brake_backlash"]
    gap = report.effects[0].parameters["gap_rad"]
    assert gap.value == pytest.approx(0.01, rel=0.05)
