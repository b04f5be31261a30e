"""Events in words: what a value of R_s is of."""

from __future__ import annotations

from orchestrator.formatting.events import SINGLE_READINGS, describe
from protocols import ResistanceEstimate, ResistanceEstimated


def described(value_ohm: float) -> str:
    estimate = ResistanceEstimate(value_ohm=value_ohm, low=0.9204, high=0.9216, first_ohm=0.9275, last_ohm=0.9277)
    text = describe(ResistanceEstimated(estimate=estimate))
    assert text is not None
    return text.text


def test_a_mean_outside_the_first_and_the_last_reading_says_why() -> None:
    assert SINGLE_READINGS in described(0.921)
    assert SINGLE_READINGS not in described(0.9276)
    assert described(0.921).endswith("the interval is of noise alone")
