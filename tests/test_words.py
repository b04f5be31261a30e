"""Names and texts of the code use the field's terms, and none of a dialect that a reader would have to learn first."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("orchestrator", "plugins", "protocols", "fluxbench")
DIALECT = {"told", "said", "asked", "heard", "hired", "nobody"}
ALLOWED_NAMES = {"asked", "OperatorAsked"}
"""Fields of files and messages that users keep: `asked` counts a fleet's recordings in which an effect was sought,
and `OperatorAsked` is a kind of entry in the journal."""
MAX_LINES_WITH_DIALECT = 20


def sources() -> list[Path]:
    return sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def names_in(tree: ast.AST) -> Iterator[str]:
    """Every name that a module gives to something."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case _:
                pass


def with_names_of_dialect(room: str) -> Iterator[tuple[Path, str]]:
    """Modules in whose text these words are at all: most need not be parsed."""
    anywhere = re.compile("|".join((*DIALECT, "made_of")), re.IGNORECASE)
    for path in sources():
        text = path.read_text(encoding="utf-8") if path.is_relative_to(ROOT / room) else ""
        if anywhere.search(text):
            yield path, text


@pytest.mark.parametrize("room", ROOMS)
def test_no_name_is_made_of_words_that_no_index_of_the_field_has(room: str) -> None:
    found = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, text in with_names_of_dialect(room)
        for name in names_in(ast.parse(text))
        if name not in ALLOWED_NAMES
        and (DIALECT & set(re.findall(r"[a-z]+", re.sub(r"([A-Z])", r" \1", name).lower())) or "made_of" in name)
    }
    assert sorted(found) == []


def test_comments_docstrings_and_messages_have_hardly_any_of_these_words() -> None:
    word = re.compile(r"\b(told|said|asked|heard|hired)\b")
    lines = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sources()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if word.search(line)
    ]
    assert len(lines) < MAX_LINES_WITH_DIALECT, "\n".join(lines)
