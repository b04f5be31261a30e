"""What equations say adds up, and grows with what is measured."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.experiment_design.information import ALTERNATIVE_SHAPES, Information, information
from orchestrator.experiment_design.rehearsal import rehearse
from tests.orchestrator.experiment_design.plans import (
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
    shapes = len(ALTERNATIVE_SHAPES)
    bends, edges = (len(effects(name)[0].Parameters.declared()) for name in ("dead_time", "voltage_bias"))
    dead_time_columns = (dead_time.amplitudes, dead_time.forms, dead_time.alternative_amplitudes)
    assert [len(columns) for columns in dead_time_columns] == [1, bends - 1, shapes]
    assert [len(bias.amplitudes), len(bias.forms), len(bias.alternative_amplitudes)] == [2, edges - 2, 0]
    places = np.concatenate([effect.all for effect in known.effects.values()])
    assert sorted(places) == list(range(known.machine_columns, known.total.shape[0]))


def test_shapes_span_those_between() -> None:
    rehearsal = rehearse(plan(HOLDS, SWEEPS), DRIVE, machine(), NOISE_A)
    library, fitter = scaled_library(effects("dead_time"), rehearsal.setup.prepared.manifest), rehearsal.setup.fitter
    shapes = information(rehearsal, library).effects["dead_time"].shapes
    linearisation = fitter.linearise(rehearsal.model)
    for x in (-1.75, -0.25, 0.25, 1.25, 1.75):
        wanted = [(a, "voltage_v") for a in (library[0].absent().moved("threshold_a", x), *shapes)]
        states = [fitter.equations.at(rehearsal.model, kept) for kept in linearisation.batches]
        columns = [row.columns for state in states for row in fitter.equations.rows(state, wanted)]
        between, spanned = np.split(np.concatenate(columns), [1], axis=1)
        left = np.linalg.lstsq(spanned, between, rcond=None)[1]
        assert left[0] < 1e-5 * np.sum(between**2)


def test_what_follows_takes_information_away_and_never_adds_any(known: Information) -> None:
    alone = known.marginal(known.total, "dead_time")
    beside = known.marginal(known.total, "dead_time", known.effects["voltage_bias"].all)
    assert 0.0 < beside[0, 0] <= alone[0, 0] < known.total[known.machine_columns, known.machine_columns]


def test_a_wider_noise_makes_less_of_the_same_equations() -> None:
    largest = []
    for noise_a in (NOISE_A, 2.0 * NOISE_A):
        rehearsal = rehearse(plan(HOLDS, SWEEPS), DRIVE, machine(), noise_a)
        library = scaled_library(effects("voltage_bias"), rehearsal.setup.prepared.manifest)
        known = information(rehearsal, library)
        largest.append(known.total[known.effects["voltage_bias"].amplitudes[-1:]].max())
    assert largest[0] / largest[1] == pytest.approx(4.0, rel=1e-6)
