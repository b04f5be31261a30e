"""Words that a procedure cannot have."""

from __future__ import annotations

import pytest

from orchestrator.validation.strict_yaml import parse_document
from protocols import ProcedureError


def test_half_a_character_is_refused_at_its_line() -> None:
    with pytest.raises(ProcedureError, match=r"plan.yaml:1: a: '\\ud800' is half a character"):
        parse_document('a: "x\\ud800"', "plan.yaml")
