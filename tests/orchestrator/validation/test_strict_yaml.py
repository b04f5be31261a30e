"""Words that a procedure cannot have."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.validation.strict_yaml import parse_document, read_document
from protocols import InputError, ProcedureError


def test_half_a_character_is_refused_at_its_line() -> None:
    with pytest.raises(ProcedureError, match=r"plan.yaml:1: a: '\\ud800' is half a character"):
        parse_document('a: "x\\ud800"', "plan.yaml")


def test_a_directory_is_no_yaml_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a directory; expected a YAML file"):
        read_document(tmp_path)
