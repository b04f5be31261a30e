"""What passes: a quantity whose whole interval is within the limits, of a map that is usable."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from orchestrator.shelf.acceptance import judge_acceptance
from orchestrator.shelf.results import RunResults
from protocols import Acceptance, AcceptanceReason, Interval, Usability

R_S = Interval(value=4.25, low=4.24, high=4.27, unit="ohm")
L_DD = Interval(value=0.043, low=0.0425, high=0.0435, unit="H")


def reason_of(limits: dict[str, Any], results: RunResults) -> AcceptanceReason:
    """The only one."""
    result = judge_acceptance(Acceptance.model_validate(limits), results)
    (reason,) = result.reasons
    assert result.passed is reason.passed
    assert result.objections == (() if reason.passed else (reason.sentence,))
    return reason


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"min_resistance_ohm": 4.0, "max_resistance_ohm": 4.5}, "passes, limit 4 Ω to 4.5 Ω"),
        ({"max_resistance_ohm": 4.27}, "passes, limit at most 4.27 Ω"),
        ({"max_resistance_ohm": 4.2}, "too large, limit at most 4.2 Ω"),
        ({"min_resistance_ohm": 4.3}, "too small, limit at least 4.3 Ω"),
        ({"max_resistance_ohm": 4.26}, "its interval exceeds the limit, limit at most 4.26 Ω"),
        ({"min_resistance_ohm": 4.245}, "its interval exceeds the limit, limit at least 4.245 Ω"),
    ],
)
def test_a_quantity_passes_where_its_whole_interval_is_within_the_limits(limits: dict[str, float], words: str) -> None:
    reason = reason_of(limits, RunResults({"resistance_ohm": R_S}))
    assert reason.sentence == f"R_s 4.250 Ω (95 %: 4.240 to 4.270): {words}"
    assert reason.passed is ("passes" in words)
    assert reason.value == R_S
    assert (reason.min, reason.max) == (limits.get("min_resistance_ohm"), limits.get("max_resistance_ohm"))


def test_a_quantity_that_was_not_measured_does_not_pass() -> None:
    reason = reason_of({"max_rated_flux_wb": 0.2}, RunResults(usability=Usability.USABLE))
    assert not reason.passed
    assert reason.sentence == "rated flux not measured: does not pass, limit at most 200 mWb"


@pytest.mark.parametrize(
    ("usability", "words"),
    [(Usability.NOT_JUDGED, "not judged"), (Usability.NOT_USABLE, "not reliable"), (None, "not judged")],
)
def test_a_quantity_of_a_map_that_is_not_usable_does_not_pass(usability: Usability | None, words: str) -> None:
    reason = reason_of({"max_l_dd_h": 0.05}, RunResults({"l_dd_h": L_DD}, usability))
    assert not reason.passed
    assert f"the map is {words}" in reason.sentence
    assert reason_of({"max_l_dd_h": 0.05}, RunResults({"l_dd_h": L_DD}, Usability.USABLE)).passed


def test_the_resistance_needs_no_map() -> None:
    assert reason_of({"max_resistance_ohm": 5.0}, RunResults({"resistance_ohm": R_S}, Usability.NOT_USABLE)).passed


def test_only_the_diagnoses_that_are_named_pass() -> None:
    limits = {"verdicts": ["clean", "explained"]}
    assert reason_of(limits, RunResults(verdict="explained")).passed
    refused = reason_of(limits, RunResults(verdict="unknown_remains"))
    assert refused.sentence == "verdict unknown remains: does not pass, limit clean or explained"
    assert not refused.passed
    assert "not diagnosed: does not pass" in reason_of(limits, RunResults()).sentence


def test_all_quantities_have_to_pass() -> None:
    limits = Acceptance(max_resistance_ohm=5.0, max_l_dd_h=0.04)
    result = judge_acceptance(limits, RunResults({"resistance_ohm": R_S, "l_dd_h": L_DD}, Usability.USABLE))
    assert [(reason.quantity, reason.passed) for reason in result.reasons] == [
        ("resistance_ohm", True),
        ("l_dd_h", False),
    ]
    assert not result.passed


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "limits nothing"),
        ({"min_l_qq_h": 0.2, "max_l_qq_h": 0.1}, "min_l_qq_h is above max_l_qq_h"),
        ({"max_resistance_ohm": "4"}, "number"),
        ({"max_resistance_ohm": -1.0}, "greater than or equal to 0"),
        ({"max_resistance": 4.0}, "Extra inputs"),
        ({"verdicts": ["fine"]}, "Input should be"),
    ],
)
def test_limits_that_say_nothing_or_contradict_each_other_are_refused(limits: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        Acceptance.model_validate(limits)
