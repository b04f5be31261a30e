"""How much was computed has a bound; how long it may go on is told in proportion to what it took so far."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.effort import Effort


def test_effort_is_exhausted_beyond_its_most() -> None:
    assert not Effort(most=2.0, spent=2.0).exhausted
    assert Effort(most=2.0, spent=2.1).exhausted


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
    effort = Effort(clock=lambda: now[0])
    # The first one loads libraries, and one of them waits for another process.
    for took_s in (70.0, 20.0, 20.0, 90.0, 18.0):
        effort.spend(10.0)
        now[0] += took_s
    effort.spend(10.0)
    effort.calibrate()
    assert effort.left == ""
    effort.expect(expected)
    now[0] += later_s
    assert effort.left == left


def test_nothing_is_told_before_anything_was_computed() -> None:
    now = [100.0]
    effort = Effort(clock=lambda: now[0])
    effort.expect(50.0)
    assert effort.left == ""
    now[0] += 5.0
    effort.spend(0.0)
    effort.calibrate()
    effort.expect(50.0)
    assert effort.left == ""
