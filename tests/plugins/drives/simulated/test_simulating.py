"""Measurements of a motor that is not there: its nameplate, its limits, and a truth that nobody sees."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from plugins.drives.simulated import simulate, usual_limits
from protocols import InputError, PluginError
from tests.plugins.drives.simulated.conftest import PM400, SERVO
from tests.support.tiny import tiny_document


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    file = tmp_path / "tiny.yaml"
    file.write_text(yaml.safe_dump(tiny_document()))
    return file


@pytest.mark.slow
def test_the_hidden_effects_are_sealed(tiny: Path, tmp_path: Path) -> None:
    done = simulate(PM400, {"voltage_bias": {"bias_a_v": 0.12345678}}, procedure=tiny, out=tmp_path / "run")
    assert done.manifest.motor.rated_current_rms_a == PM400.rated_current_rms_a
    known = [file for file in done.path.rglob("*") if file.is_file() and file.suffix in (".json", ".jsonl")]
    assert len(known) >= 3
    run = json.loads((done.path / "run.json").read_text())
    # The whole library is listed, as a part of what estimates are made with.
    assert len([one for one in run["provenance"].pop("plugins") if one["kind"] == "effects"]) > 10
    texts = [json.dumps(run), *(file.read_text() for file in known if file.name != "run.json")]
    assert not any("0.12345678" in text or "voltage_bias" in text for text in texts)
    sealed = "".join(file.read_text() for file in (tmp_path / "run.sealed").glob("*.json"))
    assert run["procedure"]["limits"]["current_a"] == 5.16
    assert '"bias_a_v": 0.12345678' in sealed


def test_limits_follow_from_the_nameplate() -> None:
    limits = usual_limits(SERVO)
    assert SERVO.rated_current_a is not None
    assert limits.current_a == pytest.approx(2.2 * SERVO.rated_current_a, rel=5e-3)
    assert limits.voltage_v == pytest.approx(1.05 * 24.0, rel=5e-3)
    with pytest.raises(InputError, match="rated_voltage_rms_v"):
        usual_limits(SERVO.model_copy(update={"rated_voltage_rms_v": None}))


def test_an_effect_that_there_is_not_is_named(tiny: Path, tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="dead_tme"):
        simulate(effects={"dead_tme": {"voltage_v": 1.0}}, procedure=tiny, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
