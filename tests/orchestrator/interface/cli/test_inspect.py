"""One effect is described in full: meaning, pattern, what to do, and its parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.interface.cli._inspect import BENCH_ADVICE
from orchestrator.interface.cli._running import run_app
from protocols import EffectLayer


def test_an_effect_is_described_with_its_pattern_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "dead_time"]) == 0
    out = capsys.readouterr().out
    for text in (
        "how it shows: ",
        "at the bench: ",
        "second PWM frequency",
        "`fluxbench tune` compensates what follows",
        "of a 400 W machine at 540 V; `diagnose`",
    ):
        assert text in out
    assert any(line.split()[:3] == ["voltage_v", "amplitude", "V"] for line in out.splitlines())


def test_an_effect_with_a_measurement_of_its_own_at_the_bench_names_that(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "skin_effect"]) == 0
    assert "a bridge at two frequencies" in capsys.readouterr().out


def test_a_misspelt_effect_gets_the_nearest_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "dead_tim"]) == 2
    assert "did you mean 'dead_time'?" in capsys.readouterr().err


OWN = """
from protocols import Correction, EffectLayer, EffectParameters, amplitude


class Choke:
    name, summary, signature, needs, gauge = "choke", "A choke in phase a.", "A residual against di_a/dt.", (), ""
    layer = EffectLayer.INVERTER

    class Parameters(EffectParameters):
        inductance_h: float = amplitude("H", typical=1e-3, prior_width=3e-3, low=-0.1, high=0.1)

    def correct(self, signals, p):
        return Correction()
"""


def test_an_effect_of_a_file_is_listed_and_described_with_advice_that_holds_for_its_layer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "choke.py").write_text(OWN)
    assert run_app(["effects", "--effects", str(tmp_path / "choke.py")]) == 0
    out = capsys.readouterr().out
    assert "A choke in phase a." in out
    assert "hysteresis" in out
    assert run_app(["effects", "choke", "--effects", str(tmp_path / "choke.py")]) == 0
    out = capsys.readouterr().out
    assert "at the bench: measure between the motor's terminals" in out
    assert "dead time" not in out
    assert run_app(["effects", "chok", "--effects", str(tmp_path / "choke.py")]) == 2
    assert "did you mean 'choke'?" in capsys.readouterr().err


def test_each_layer_has_advice() -> None:
    assert BENCH_ADVICE.keys() == set(EffectLayer)
