"""The procedure of docs/moteus.md, run from its first stage to its estimate on an emulated board."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("moteus", reason="the official library of moteus is an optional extra")

from orchestrator.config import load_procedure
from orchestrator.engine import SAFE_BENCH_WORDS, AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.recording import open_recording
from protocols import SegmentStage
from tests.plugins.drives.moteus.emulator import fdcanusb

PAGE = Path(__file__).parents[4] / "docs" / "moteus.md"


def procedure_of_the_page() -> dict[str, Any]:
    found = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None, f"{PAGE} shows no procedure"
    document: dict[str, Any] = yaml.safe_load(found[1])
    return document


@pytest.mark.slow
def test_the_page_s_procedure_runs_and_its_holds_show_the_resistance(tmp_path: Path) -> None:
    document, file = procedure_of_the_page(), tmp_path / "procedure.yaml"
    with fdcanusb() as port:
        document["drive"]["port"] = port.path
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        result = start_run(
            load_procedure(str(file)), tmp_path / "run", RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts())
        )
        assert port.servo.mode == 0, "the power stage is still on"
        assert port.servo.configuration["servo.max_current_A"] == 20.0
    assert result.outcome.ending == "finished", result.outcome.reason
    assert result.outcome.estimates is not None
    assert result.outcome.estimates.resistance is not None
    recording = open_recording(tmp_path / "run")
    segments = recording.segments(SegmentStage.RESISTANCE)
    assert len(segments) == 8
    for segment in segments:
        capture = recording.load(segment)
        i, v = capture.i_ab.mean(axis=0, dtype=float), capture.v_ab.mean(axis=0, dtype=float)
        assert v @ i / (i @ i) == pytest.approx(0.4, rel=0.01), segment.id
