"""How much is computed has a bound, how long it may go on is in proportion, and moves are numbered in order."""

from __future__ import annotations

import math

import pytest

from orchestrator.diagnosis.fitting.progress import Budget, SearchRecorder


def test_effort_is_exhausted_beyond_its_most() -> None:
    assert not Budget(limit=2.0, spent=2.0).is_spent
    assert Budget(limit=2.0, spent=2.1).is_spent


@pytest.mark.parametrize(
    ("expected", "later_s", "left"),
    [
        (40.0, 0.0, " (some 80 s more)"),
        (40.0, 33.0, " (some 45 s more)"),
        (2.6, 0.0, " (some 5 s more)"),
        (2.6, 5.0, ""),
    ],
)
def test_what_is_left_takes_as_long_as_most_evaluations_in_proportion(
    expected: float, later_s: float, left: str
) -> None:
    now = [100.0]
    budget = Budget(clock=lambda: now[0])
    # The first one loads libraries, and one of them waits for another process.
    for took_s in (70.0, 20.0, 20.0, 90.0, 18.0):
        budget.spend(10.0)
        now[0] += took_s
    budget.spend(10.0)
    budget.calibrate()
    assert budget.remaining_time == ""
    budget.expect(expected)
    now[0] += later_s
    assert budget.remaining_time == left


def test_a_few_slow_first_evaluations_predict_nothing() -> None:
    now = [0.0]
    budget = Budget(clock=lambda: now[0])
    budget.spend(10.0)
    now[0] += 70.0
    budget.calibrate()
    budget.expect(40.0)
    assert budget.remaining_time == ""
    for _ in range(10):
        budget.spend(10.0)
        now[0] += 2.0
    budget.expect(40.0)
    assert budget.remaining_time == " (some 8 s more)"


def test_nothing_is_reported_before_anything_was_computed() -> None:
    now = [100.0]
    budget = Budget(clock=lambda: now[0])
    budget.expect(50.0)
    assert budget.remaining_time == ""
    now[0] += 5.0
    budget.spend(0.0)
    budget.calibrate()
    budget.expect(50.0)
    assert budget.remaining_time == ""


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
