"""Numbers and words that a procedure cannot have."""

from __future__ import annotations

import pytest

from orchestrator.validation.strict_yaml import parse_document
from protocols import ProcedureError


@pytest.mark.parametrize("number", ["5e-324", "1e-31", "-1e-31", "1e-400"])
def test_a_number_too_small_to_divide_by_is_refused_at_its_line(number: str) -> None:
    with pytest.raises(ProcedureError) as refused:
        parse_document(f"a: 1\nb: {number}\n", "plan.yaml")
    assert str(refused.value) == f"plan.yaml:2: b: {number} is too small a number"


@pytest.mark.parametrize(("text", "value"), [("0.0", 0.0), ("0e5", 0.0), ("1e-30", 1e-30), ("-2e-12", -2e-12)])
def test_zero_and_small_numbers_are_numbers(text: str, value: float) -> None:
    assert parse_document(f"a: {text}", "plan.yaml").data == {"a": value}


def test_half_a_character_is_refused_at_its_line() -> None:
    with pytest.raises(ProcedureError, match=r"plan.yaml:1: a: '\\ud800' is half a character"):
        parse_document('a: "x\\ud800"', "plan.yaml")
