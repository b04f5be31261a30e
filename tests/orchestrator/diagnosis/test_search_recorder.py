"""The record of a search: numbered in order, of whole and part alike, with what it cost so far."""

from __future__ import annotations

import math

from orchestrator.diagnosis.fitting.budget import Budget
from orchestrator.diagnosis.search_recorder import SearchRecorder


def test_moves_on_a_part_and_on_the_whole_are_one_sequence() -> None:
    budget = Budget()
    whole = SearchRecorder(budget, samples=100)
    part = whole.of_part()
    part.record("screen", ["dead_time"], measure="chi2", score=50.0, threshold=32.0)
    budget.spent = 250.0
    whole.record("add", ["dead_time"], taken=True)
    part.record("remove", ["dead_time"], taken=False, note="it is needed")
    assert [(e.step, e.data, e.decision) for e in whole.events] == [
        (1, "part", "tested"), (2, "whole", "accepted"), (3, "part", "rejected"),
    ]  # fmt: skip
    assert [e.evaluations for e in part.events] == [0.0, 2.5, 2.5]
    assert whole.events[0].seconds <= whole.events[2].seconds


def test_a_score_that_is_not_finite_is_left_out() -> None:
    recorder = SearchRecorder()
    recorder.record("remove", ["dead_time"], measure="block_scatter", score=math.inf, threshold=0.2, taken=True)
    assert recorder.events[0].score is None
