"""The page's lists: what is in a folder, and what is preselected."""

from __future__ import annotations

from pathlib import Path

from plugins.commands.serve._choices import choices
from protocols import shipped_procedures


def test_the_plain_procedure_is_the_first_of_those_shipped(tmp_path: Path) -> None:
    names = [one["name"] for one in choices(tmp_path)["procedures"]]
    assert names[0] == "demo"
    assert sorted(names) == sorted(shipped_procedures())
