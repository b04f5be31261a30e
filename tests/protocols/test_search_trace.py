"""The moves of a search as a file has them."""

from __future__ import annotations

import pytest

from protocols import SearchEvent


@pytest.mark.parametrize(
    ("written", "read"),
    [("taken", "accepted"), ("refused", "rejected"), ("tried", "tested"), ("accepted", "accepted")],
)
def test_decisions_in_files_of_earlier_versions_have_todays_names(written: str, read: str) -> None:
    event = {
        "step": 1,
        "move": "add",
        "effects": [],
        "data": "part",
        "decision": written,
        "evaluations": 1,
        "seconds": 1,
    }
    assert SearchEvent.model_validate(event).decision == read
