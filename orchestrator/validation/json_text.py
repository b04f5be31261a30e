"""JSON as values whose text can be written again."""

from __future__ import annotations

import json
from typing import Any


def parse_json(text: str | bytes, **options: Any) -> Any:
    """The value of a JSON text, as `json.loads` with these options; raises `ValueError`.

    JSON may escape half of a surrogate pair, which Python reads as a character that no file and no terminal can take.
    """
    value = json.loads(text, **options)
    escape = b"\\ud" if isinstance(text, bytes) else "\\ud"
    if escape in text.lower():  # type: ignore[operator]
        refuse_half_characters(json.dumps(value, ensure_ascii=False))
    return value


def refuse_half_characters(text: str) -> None:
    """Raise `ValueError` where a text has half of a surrogate pair."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{error.object[error.start]!a} is half a character") from None
