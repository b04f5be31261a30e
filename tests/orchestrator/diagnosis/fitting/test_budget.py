"""How much was computed has a bound; how long it may go on is reported in proportion to what it took so far."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.budget import Budget


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
