"""The page on the method names modules that are there, and leaves no room out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ROOMS = ROOT / "orchestrator" / "diagnosis"
PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([\w/]+\.py)`", PAGE))


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
