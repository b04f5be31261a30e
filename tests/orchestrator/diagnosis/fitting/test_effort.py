"""How much was computed has a bound; how long it may go on is told in proportion to what it took so far."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.effort import Effort


def test_effort_is_exhausted_beyond_its_most() -> None:
    assert not Effort(most=2.0, spent=2.0).exhausted
    assert Effort(most=2.0, spent=2.1).exhausted


@pytest.mark.parametrize(
    ("part", "later_s", "left"),
    [(0.2, 0.0, " (some 80 s more)"), (0.2, 33.0, " (some 45 s more)"), (0.8, 0.0, " (some 5 s more)"), (0.8, 9.0, "")],
)
def test_what_is_left_takes_as_long_in_proportion(part: float, later_s: float, left: str) -> None:
    now = [100.0]
    effort = Effort(clock=lambda: now[0])
    assert effort.left == ""
    now[0] += 20.0
    effort.reached(part)
    now[0] += later_s
    assert effort.left == left
