"""Thresholds say what they are, and a diagnosis says with which it was made."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel, ValidationError

from orchestrator.diagnosis.criteria import (
    Criteria,
    FittingCriteria,
    MaterialityCriteria,
    SelectionCriteria,
    VerdictCriteria,
)
from orchestrator.validation.thresholds import Source
from protocols import VerdictLimits

PAGE = Path(__file__).parents[3] / "docs" / "settings.md"
MOST_SETTINGS = 45

ROOMS: list[type[BaseModel]] = [type(getattr(Criteria(), room)) for room in Criteria.model_fields]
FIELDS = {f"{room.__name__}.{name}": field for room in ROOMS for name, field in room.model_fields.items()}


def rows_of(room: str) -> list[str]:
    """The page's rows of a room: name, default, unit, meaning and source of each setting."""
    rows = []
    for name, field in type(getattr(Criteria(), room)).model_fields.items():
        extra: Any = field.json_schema_extra
        meaning = " ".join((field.description or "").split()).replace("``", "`")
        unit = "" if extra["unit"] == "1" else extra["unit"]
        rows.append(f"| `{name}` | {field.default} | {unit} | {meaning} | {extra['source']} |")
    return rows


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


def test_there_are_few_settings() -> None:
    assert len(FIELDS) <= MOST_SETTINGS


def test_the_verdict_and_the_search_share_no_setting() -> None:
    search = {name for room in (SelectionCriteria, FittingCriteria) for name in room.model_fields}
    assert not search & VerdictLimits.model_fields.keys()
    others = VerdictCriteria.model_fields.keys() | MaterialityCriteria.model_fields.keys()
    assert VerdictLimits.model_fields.keys() <= others


def test_the_page_lists_every_setting() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    assert rows == [row for room in Criteria.model_fields for row in rows_of(room)]
    for room in Criteria.model_fields:
        assert f"## `{room}`" in text
