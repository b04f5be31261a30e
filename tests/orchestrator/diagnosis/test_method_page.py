"""The page on the method names modules that exist, leaves out no package, and states thresholds as the code does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import get_args

import pytest
from pydantic import BaseModel

import orchestrator.diagnosis
from orchestrator.diagnosis.criteria import Criteria
from protocols import Verdict, VerdictLimits

ROOT = Path(__file__).parents[3]
ROOMS = ROOT / "orchestrator" / "diagnosis"
PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([\w/]+\.py)`", PAGE))
THRESHOLDS = re.findall(r"`(\w+)` = (\d+(?:\.\d+)?(?:e-?\d+)?)", PAGE)


def test_every_module_that_the_page_names_is_there() -> None:
    here = {name for name in NAMED if "/" in name}
    assert len(here) > 20
    for name in here:
        assert (ROOMS / name).is_file() or (ROOT / name).is_file(), name


def test_every_room_is_on_the_page() -> None:
    rooms = {path.name for path in ROOMS.iterdir() if (path / "__init__.py").is_file()}
    assert rooms == {name.split("/")[0] for name in NAMED if (ROOMS / name).is_file() and "/" in name}


@pytest.mark.parametrize("room", ["orchestrator/recording_checks", "orchestrator/experiment_design"])
def test_the_rooms_beside_the_diagnosis_are_on_the_page(room: str) -> None:
    assert (ROOT / room).is_dir()
    assert f"`{room}" in PAGE


def fields_of(model: BaseModel) -> Iterator[tuple[str, object]]:
    """Every field of a model and of the models in it, as (name, value)."""
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from fields_of(value)
        else:
            yield name, value


def constants() -> Iterator[tuple[str, object]]:
    """Every module-level constant of the diagnosis, as (name, value)."""
    package = orchestrator.diagnosis
    for found in walk_packages(package.__path__, f"{package.__name__}."):
        for name, value in vars(import_module(found.name)).items():
            if name.isupper():
                yield name.lstrip("_"), value


@cache
def numbers_of_code() -> dict[str, set[float]]:
    """The numbers that a threshold's name, in lower case, has among criteria and constants."""
    numbers: dict[str, set[float]] = {}
    for name, value in (*fields_of(Criteria()), *constants()):
        if isinstance(value, int | float):
            numbers.setdefault(name.lower(), set()).add(float(value))
    return numbers


def test_the_page_states_each_threshold_once_and_few_of_them() -> None:
    names = [name for name, _ in THRESHOLDS]
    assert 10 <= len(names) <= 15
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(("name", "stated"), THRESHOLDS)
def test_a_threshold_on_the_page_is_the_code_s(name: str, stated: str) -> None:
    assert numbers_of_code().get(name.lower()) == {float(stated)}


def test_every_name_in_the_table_of_verdicts_has_a_number_or_is_a_limit_of_the_record() -> None:
    section = PAGE.split("\n## 8. ")[1].split("\n## ")[0]
    table = "\n".join(line for line in section.splitlines() if line.startswith("|"))
    names = set(re.findall(r"`(\w+)`", table))
    verdicts = set(get_args(Verdict)) - {"cannot_tell"}
    assert verdicts <= names
    assert names <= verdicts | {name for name, _ in THRESHOLDS} | set(VerdictLimits.model_fields)
