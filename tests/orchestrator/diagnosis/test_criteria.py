"""Thresholds say what they are, and a diagnosis says with which it was made."""

from __future__ import annotations

from typing import Any, get_args

import pytest
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from orchestrator.diagnosis import Criteria
from orchestrator.diagnosis.criteria import Source

ROOMS: list[type[BaseModel]] = [type(getattr(Criteria(), room)) for room in Criteria.model_fields]
FIELDS = [
    pytest.param(field, id=f"{room.__name__}.{name}") for room in ROOMS for name, field in room.model_fields.items()
]


@pytest.mark.parametrize("field", FIELDS)
def test_every_threshold_has_a_unit_a_reason_and_a_source(field: FieldInfo) -> None:
    extra: Any = field.json_schema_extra
    assert extra["unit"]
    assert extra["source"] in get_args(Source)
    assert field.description is not None
    assert field.description.rstrip().endswith((".", "..."))


def test_no_name_stands_for_two_things() -> None:
    names = [name for room in ROOMS for name in room.model_fields]
    assert len(set(names)) == len(names)


def test_what_was_misspelt_is_refused_and_what_is_there_cannot_be_changed() -> None:
    with pytest.raises(ValidationError):
        Criteria.model_validate({"selection": {"log_evidense": 3.0}})
    with pytest.raises(ValidationError):
        Criteria().selection.log_evidence = 3.0  # type: ignore[misc]
