"""Columns that were measured not to have moved are kept, those that have are made anew, and both are derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.columns import (
    MAX_COLUMN_CHANGE,
    MAX_GROWTH_BEFORE_PROBE,
    MIN_RESPONSE,
    ColumnProbe,
    column_plan,
    known_responses,
    probe_segments,
)
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.numerics.types import Array
from protocols import SegmentStage
from tests.orchestrator.diagnosis.fitting.test_corrections import ACTIVE, EFFECTS, SIZES
from tests.orchestrator.diagnosis.pieces import CRITERIA, Plan, fitter, free_model, hold, plan, prepared, ripple

LIMITS = CRITERIA.fitting


@pytest.fixture(scope="module")
def maker() -> Fitter:
    settings = {"frequency_hz": 500.0, "rotation_hz": 4.0, "amplitude_v": 40.0}
    more = [Plan(SegmentStage.INJECTION, ripple(x, 1.0 - x, 40.0), settings=settings) for x in np.linspace(-2, 2, 9)]
    return fitter(
        prepared([*plan(), *(Plan(SegmentStage.RESISTANCE, hold(x, 0.2)) for x in np.linspace(-2, 2, 9)), *more])
    )


def all_effects(maker: Fitter, times: float = 1.0) -> Model:
    active = []
    for candidate in scaled_library(EFFECTS, maker.prepared.manifest):
        values = {name: times * value for name, value in SIZES[candidate.name].items()}
        active.append(EffectTerm(candidate, {**candidate.absent().values, **values}, candidate.amplitudes))
    return free_model().with_active(active)


def whole(maker: Fitter, model: Model, fit: Fit) -> list[Array]:
    """Every column of every training segment, each led through all effects."""
    columns: dict[int, Array] = {}
    for linearisation in fit.linearisation.batches:
        rows = maker.equations.rows(maker.equations.at(model, linearisation), model.free)
        columns |= {k: row.columns for k, row in zip(linearisation.batch.places, rows, strict=True)}
    return [columns[k] for k, p in enumerate(maker.prepared.pieces) if not p.held_out]


def distance(some: list[Array], others: list[Array]) -> Array:
    """Relative distance of each column; of what does not show both are nothing."""
    a, b = np.concatenate(some), np.concatenate(others)
    shows = np.sum(b**2, axis=0) > 0.0
    assert not a[:, ~shows].any()
    return np.asarray(np.sqrt(np.sum((a - b)[:, shows] ** 2, axis=0) / np.sum(b[:, shows] ** 2, axis=0)))


def training(maker: Fitter, fit: Fit) -> list[Array]:
    return [c for p, c in zip(maker.prepared.pieces, fit.columns, strict=True) if not p.held_out]


def test_columns_through_effects_that_answer_are_the_whole_ones(maker: Fitter) -> None:
    model = all_effects(maker)
    fit = maker.evaluate(model, maker.linearise(model))
    assert fit.parameters == tuple((a.name, n) for a, n in model.free)
    assert distance(training(maker, fit), whole(maker, model, fit)).max() < len(ACTIVE) * MIN_RESPONSE


def test_columns_that_moved_are_made_anew_and_others_are_not(maker: Fitter) -> None:
    first = all_effects(maker)
    known = maker.evaluate(first, maker.linearise(first))
    model = all_effects(maker, 1.05)
    kept = maker.evaluate(model, known.linearisation, known=known)
    far = distance(training(maker, kept), whole(maker, model, kept))
    assert far.max() < 2.0 * MAX_COLUMN_CHANGE + len(ACTIVE) * MIN_RESPONSE
    last = next(k for k in reversed(range(len(kept.columns))) if not maker.prepared.pieces[k].held_out)
    assert last not in probe_segments(maker.prepared.pieces)
    same = [np.array_equal(a, b) for a, b in zip(kept.columns[last].T, known.columns[last].T, strict=True)]
    assert any(same)


def test_effects_are_requested_once_whether_they_answer_and_again_where_they_have_grown(maker: Fitter) -> None:
    first = all_effects(maker)
    known = maker.evaluate(first, maker.linearise(first))
    assert set(known.responses.of) == set(known.parameters)
    assert known_responses(all_effects(maker, 1.05), known) is known.responses
    grown = known_responses(all_effects(maker, 1.1 * MAX_GROWTH_BEFORE_PROBE), known)
    assert not grown.of
    assert set(grown.sizes) == {candidate.name for candidate in scaled_library(EFFECTS, maker.prepared.manifest)}
    assert not known_responses(first, None).of


@pytest.mark.slow
def test_a_wholly_different_model_keeps_no_column_that_moved(maker: Fitter) -> None:
    first = all_effects(maker, 0.1)
    known = maker.evaluate(first, maker.linearise(first))
    model = all_effects(maker, 3.0)
    fit = maker.evaluate(model, maker.linearise(model), known=known)
    far = distance(training(maker, fit), whole(maker, model, fit))
    assert far.max() < 2.0 * MAX_COLUMN_CHANGE + len(ACTIVE) * MIN_RESPONSE


def test_segments_of_every_stage_are_probed_and_none_that_is_held_out(maker: Fitter) -> None:
    pieces = maker.prepared.pieces
    probed = probe_segments(pieces)
    assert {pieces[k].stage for k in probed} == {p.stage for p in pieces}
    assert not any(pieces[k].held_out for k in probed)
    assert len(probed) < len(pieces) / 2


def test_an_answer_counts_by_its_share_of_the_column() -> None:
    columns = np.array([[3.0, 0.0], [4.0, 1.0]])
    responses = {
        (0, "loud"): (2.0 * MIN_RESPONSE * 5.0) ** 2,
        (0, "silent"): (0.5 * MIN_RESPONSE * 5.0) ** 2,
        (1, "silent"): (0.5 * MIN_RESPONSE) ** 2,
    }
    plan = column_plan([("one", "x"), ("two", "y")], {0: ColumnProbe(columns, responses)}, None)
    assert plan.answering == (frozenset({"loud"}), frozenset())
    assert plan.anew == [0, 1]
    assert not plan.kept
