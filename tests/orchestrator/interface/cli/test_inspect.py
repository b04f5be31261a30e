"""One effect is described in full: meaning, pattern, what to do, and its parameters."""

from __future__ import annotations

import pytest

from orchestrator.interface.cli._inspect import BENCH_ADVICE
from orchestrator.interface.cli._running import run_app
from protocols import EffectLayer


def test_an_effect_is_described_with_its_pattern_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "dead_time"]) == 0
    out = capsys.readouterr().out
    for text in ("how it shows: ", "at the bench: ", "second PWM frequency", "`fluxbench tune` compensates it"):
        assert text in out
    assert any(line.split()[:3] == ["voltage_v", "amplitude", "V"] for line in out.splitlines())


def test_an_effect_with_a_measurement_of_its_own_at_the_bench_names_that(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "skin_effect"]) == 0
    assert "a bridge at two frequencies" in capsys.readouterr().out


def test_a_misspelt_effect_gets_the_nearest_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["effects", "dead_tim"]) == 2
    assert "did you mean 'dead_time'?" in capsys.readouterr().err


def test_each_layer_has_advice() -> None:
    assert BENCH_ADVICE.keys() == set(EffectLayer)
