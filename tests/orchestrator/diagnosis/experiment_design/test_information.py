"""What equations say adds up, and grows with what is measured."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.experiment_design.information import Information, information
from orchestrator.diagnosis.experiment_design.rehearsal import rehearse
from orchestrator.diagnosis.fitting.candidates import scaled_library
from tests.orchestrator.diagnosis.experiment_design.plans import (
    DRIVE,
    GATES_OFF,
    HOLDS,
    NOISE_A,
    SWEEPS,
    effects,
    machine,
    plan,
)


@pytest.fixture(scope="module")
def known() -> Information:
    rehearsal = rehearse(plan(GATES_OFF, HOLDS, SWEEPS), DRIVE, machine(), NOISE_A)
    return information(
        rehearsal, scaled_library(effects("dead_time", "voltage_bias"), rehearsal.setup.prepared.manifest)
    )


def test_stages_add_up_to_the_whole(known: Information) -> None:
    parts = sum(known.of_stages([k]) for k in range(3))
    np.testing.assert_allclose(parts, known.total, rtol=1e-12)


def test_every_effect_has_columns_for_its_amplitudes_in_every_shape(known: Information) -> None:
    dead_time, bias = known.effects["dead_time"], known.effects["voltage_bias"]
    assert [len(v.amplitudes) for v in dead_time] == [1] * 4
    assert [len(v.forms) for v in dead_time] == [3] * 4
    assert [(len(v.amplitudes), len(v.forms)) for v in bias] == [(2, 0)]
    places = np.concatenate([v.columns for of in known.effects.values() for v in of])
    assert sorted(places) == list(range(known.machine, known.total.shape[0]))


def test_what_follows_takes_information_away_and_never_adds_any(known: Information) -> None:
    alone = known.left(known.total, "dead_time")
    beside = known.left(known.total, "dead_time", known.effects["voltage_bias"][0])
    assert 0.0 < beside[0, 0] <= alone[0, 0] < known.total[known.machine, known.machine]


def test_a_wider_noise_makes_less_of_the_same_equations() -> None:
    said = []
    for noise_a in (NOISE_A, 2.0 * NOISE_A):
        rehearsal = rehearse(plan(HOLDS, SWEEPS), DRIVE, machine(), noise_a)
        library = scaled_library(effects("voltage_bias"), rehearsal.setup.prepared.manifest)
        said.append(information(rehearsal, library).total[-1, -1])
    assert said[0] / said[1] == pytest.approx(4.0, rel=1e-6)
