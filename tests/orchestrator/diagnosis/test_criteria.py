"""Thresholds say what they are, and a diagnosis says with which it was made."""

from __future__ import annotations

from typing import Any, get_args

import pytest
from pydantic import BaseModel, ValidationError

from orchestrator.diagnosis import Criteria
from orchestrator.thresholds import Source

ROOMS: list[type[BaseModel]] = [type(getattr(Criteria(), room)) for room in Criteria.model_fields]
FIELDS = {f"{room.__name__}.{name}": field for room in ROOMS for name, field in room.model_fields.items()}


def test_every_threshold_has_a_unit_a_reason_and_a_source() -> None:
    for name, field in FIELDS.items():
        extra: Any = field.json_schema_extra
        assert extra["unit"], name
        assert extra["source"] in get_args(Source), name
        assert field.description is not None, name
        assert field.description.rstrip().endswith((".", "...")), name


def test_no_name_stands_for_two_things() -> None:
    names = [name for room in ROOMS for name in room.model_fields]
    assert len(set(names)) == len(names)


def test_what_was_misspelt_is_refused_and_what_is_there_cannot_be_changed() -> None:
    with pytest.raises(ValidationError):
        Criteria.model_validate({"selection": {"log_evidense": 3.0}})
    with pytest.raises(ValidationError):
        Criteria().selection.log_evidence = 3.0  # type: ignore[misc]
