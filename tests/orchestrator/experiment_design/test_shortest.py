"""Nothing is left in the shortest plan that is redundant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis import Criteria
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.experiment_design.information import information
from orchestrator.experiment_design.isolability import isolability
from orchestrator.experiment_design.rehearsal import rehearse
from orchestrator.experiment_design.shortest import OPTIMALITY_TOLERANCE, SIZE_MARGIN, Offer, out_of_reach, shortest
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

FEW = Criteria().selection.model_copy(update={"few_views": 3})
CRITERIA = Criteria().model_copy(update={"selection": FEW})


def offer(*stages: dict[str, Any]) -> Offer:
    rehearsal = rehearse(plan(*stages), DRIVE, machine(), NOISE_A)
    library = scaled_library(effects("current_offset", "voltage_bias"), rehearsal.setup.prepared.manifest)
    return Offer(rehearsal.plan.points, information(rehearsal, library))


@pytest.fixture(scope="module")
def whole() -> Offer:
    return offer(GATES_OFF, HOLDS, SWEEPS)


def test_it_suffices_and_less_of_it_would_not(whole: Offer) -> None:
    plan = shortest(whole, 0.3, CRITERIA)
    result = isolability(whole.known, whole.normal(plan.times), CRITERIA)
    assert result.beyond(0.3) == []
    assert plan.approximate.excess <= OPTIMALITY_TOLERANCE
    for k in np.flatnonzero(plan.times):
        fewer = plan.times.copy()
        fewer[k] -= 1.0
        size = 0.3 / SIZE_MARGIN
        does = not isolability(whole.known, whole.normal(fewer), CRITERIA).beyond(size)
        assert not (does and whole.covers_plane(fewer, CRITERIA))


def test_the_gates_are_off_where_an_offset_is_to_be_separated_from_a_bias(whole: Offer) -> None:
    plan = shortest(whole, 0.3, CRITERIA)
    assert whole.points[0].excitation.kind == "gates_off"
    assert plan.times[0] >= 1.0


def test_a_smaller_size_takes_more_time(whole: Offer) -> None:
    large, small = (shortest(whole, size, CRITERIA).times @ whole.seconds for size in (0.5, 0.05))
    assert small > large


def test_what_is_offered_in_vain_is_stated() -> None:
    assert out_of_reach(offer(HOLDS, SWEEPS), 1.0, CRITERIA) == [("current_offset", "voltage_bias")]


def test_currents_next_to_each_other_are_one_place(whole: Offer) -> None:
    enough = replace(whole, points=whole.points[1:9])
    times = np.ones(8)
    six = CRITERIA.selection.model_copy(update={"few_views": 8})
    nine = CRITERIA.selection.model_copy(update={"few_views": 9})
    assert enough.covers_plane(times, CRITERIA.model_copy(update={"selection": six}))
    assert not enough.covers_plane(times, CRITERIA.model_copy(update={"selection": nine}))
