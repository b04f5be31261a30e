"""What a plan is predicted to tell follows the physics of what it measures."""

from __future__ import annotations

import json
import math
from itertools import combinations
from pathlib import Path
from typing import Any, cast

import pytest

from orchestrator.config import load_procedure, make_plan
from orchestrator.diagnosis import Criteria, diagnose_recording
from orchestrator.diagnosis.fitting.candidates import scaled_library, value_at
from orchestrator.experiment_design.information import information
from orchestrator.experiment_design.isolability import Isolability, isolability
from orchestrator.experiment_design.rehearsal import rehearse
from orchestrator.recording import Recording
from orchestrator.registry.plugins import PluginKind, make_plugins
from protocols import ParameterRole, Procedure
from tests.orchestrator.experiment_design.plans import (
    DRIVE,
    GATES_OFF,
    HOLDS,
    NOISE_A,
    RIPPLE,
    SWEEPS,
    effects,
    machine,
    plan,
)
from tests.support.simulated import measure

LOUD_A = 0.5
"""So loud that sizes are above the least that a diagnosis names."""


def isolability_of(
    *stages: dict[str, Any], names: tuple[str, ...], noise_a: float = NOISE_A, repeats: int = 1
) -> Isolability:
    rehearsal = rehearse(plan(*stages, repeats=repeats), DRIVE, machine(), noise_a)
    known = information(rehearsal, scaled_library(effects(*names), rehearsal.setup.prepared.manifest))
    return isolability(known, known.total, Criteria())


def test_repetitions_shrink_the_least_sizes_by_their_root() -> None:
    names = ("voltage_bias", "phase_resistance_imbalance")
    once, often = (isolability_of(HOLDS, SWEEPS, names=names, noise_a=LOUD_A, repeats=n).detection for n in (2, 8))
    for name in names:
        # Its log det grows with what is known, so that the threshold is a little higher.
        assert once[name] / often[name] == pytest.approx(2.0, rel=0.1)


def test_twice_the_noise_takes_twice_the_size() -> None:
    quiet, loud = (isolability_of(HOLDS, SWEEPS, names=("voltage_bias",), noise_a=a).detection for a in (0.5, 1.0))
    assert loud["voltage_bias"] / quiet["voltage_bias"] == pytest.approx(2.0, rel=0.1)


def test_gates_off_parts_an_offset_from_a_bias() -> None:
    names, pair = ("current_offset", "voltage_bias"), ("current_offset", "voltage_bias")
    assert isolability_of(HOLDS, SWEEPS, names=names).separation[pair] > 1.0
    assert isolability_of(GATES_OFF, HOLDS, SWEEPS, names=names).separation[pair] < 0.3


def test_a_second_pwm_frequency_parts_dead_time_from_device_drop() -> None:
    names, pair = ("dead_time", "device_drop"), ("dead_time", "device_drop")
    at_two = {**HOLDS, "pwm_frequencies_hz": [10_000.0, 20_000.0]}
    assert isolability_of(HOLDS, SWEEPS, names=names).separation[pair] > 1.0
    assert isolability_of(at_two, SWEEPS, names=names).separation[pair] < 0.1


def test_what_shows_in_the_ripple_is_not_found_without_any() -> None:
    assert isolability_of(HOLDS, SWEEPS, names=("voltage_delay",)).detection["voltage_delay"] > 1.0
    assert isolability_of(HOLDS, SWEEPS, RIPPLE, names=("voltage_delay",)).detection["voltage_delay"] < 0.2


def test_no_stage_ever_makes_anything_harder_to_tell() -> None:
    names = ("current_offset", "voltage_bias", "dead_time", "current_gain_mismatch")
    less, more = isolability_of(HOLDS, SWEEPS, names=names), isolability_of(HOLDS, SWEEPS, GATES_OFF, names=names)
    assert all(more.detection[name] <= less.detection[name] * (1 + 1e-9) for name in names)
    assert all(more.among_all[name] <= less.among_all[name] * (1 + 1e-9) for name in names)
    assert all(more.separation[pair] <= less.separation[pair] * (1 + 1e-9) for pair in less.separation)


def test_company_never_makes_anything_easier_and_every_pair_is_there_once() -> None:
    names = ("current_offset", "voltage_bias", "skin_effect")
    result = isolability_of(HOLDS, SWEEPS, RIPPLE, names=names)
    assert all(result.among_all[name] >= result.detection[name] for name in names)
    assert set(result.separation) == set(combinations(result.names, 2))


def test_pairs_of_effects_that_are_not_found_are_not_requested_about() -> None:
    result = Isolability(("a", "b", "c"), {"a": 0.1, "b": 3.0, "c": 0.1}, {}, {("a", "b"): 9.0, ("a", "c"): math.inf})
    assert result.beyond(1.0) == [("b",), ("a", "c")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["current_gain_mismatch", "skin_effect", "phase_resistance_imbalance", "winding_heating"]
)
def test_a_simulated_bench_finds_what_was_predicted_and_not_what_is_smaller(name: str, tmp_path: Path) -> None:
    noise_a = 0.1
    rehearsal = rehearse(make_plan(_bench({}, noise_a), DRIVE), DRIVE, machine(), noise_a)
    (candidate,) = library = scaled_library(effects(name), rehearsal.setup.prepared.manifest)
    known = information(rehearsal, library)
    size = isolability(known, known.total, Criteria()).detection[name]
    shapes = {n: candidate.named(n).typical for n in candidate.of_role(ParameterRole.SHAPE)}
    named = {}
    for factor in (0.3, 2.0):
        coordinates = dict(zip(candidate.amplitudes, factor * size * known.effects[name].typical, strict=True))
        values = {n: value_at(candidate.named(n), x) for n, x in coordinates.items()}
        recording = measure(_bench({name: {**shapes, **values}}, noise_a)).recording
        report = diagnose_recording(cast(Recording, recording), make_plugins(PluginKind.EFFECTS), out=tmp_path).report
        named[factor] = [{effect.name, *effect.twins} for effect in report.effects]
    assert named[0.3] == []
    assert len(named[2.0]) == 1
    assert name in named[2.0][0]


def _bench(hidden: dict[str, dict[str, float]], noise_a: float) -> Procedure:
    """The demo with a few points of each stage, as a plant that saturates measures it."""
    changes = [
        f"drive.plant.effects={json.dumps(hidden)}",
        f"drive.plant.sensors.noise_a={noise_a}",
        "stages.7.held_a=[0]",
        "stages.8.step_a=1.45",
    ]
    whole = load_procedure("demo", overrides=changes)
    kept = tuple(stage for stage in whole.stages if stage.kind in ("resistance", "classical", "injection"))
    return whole.model_copy(update={"stages": kept})
