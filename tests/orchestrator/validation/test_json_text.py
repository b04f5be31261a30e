"""JSON whose text can be written again."""

from __future__ import annotations

import pytest

from orchestrator.validation.json_text import parse_json


@pytest.mark.parametrize("text", [r'{"a": "x\ud800"}', rb'{"a": "\uDFFFx"}', r'{"\ud83d": 1}'])
def test_half_of_a_surrogate_pair_is_refused(text: str | bytes) -> None:
    with pytest.raises(ValueError, match="is half a character"):
        parse_json(text)


def test_a_whole_pair_is_a_character() -> None:
    assert parse_json(r'{"a": "\ud83d\ude00"}') == {"a": "\U0001f600"}
