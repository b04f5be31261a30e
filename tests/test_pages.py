"""The language of the pages: short sentences, and no words of a private dialect."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAX_WORDS = 35
"""Words of a sentence. The aim is 25; this is where a reader has lost the beginning."""
DIALECT = re.compile(r"\b(?:is told by|nobody|heard|hired)\b", re.IGNORECASE)
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))

_MARK = re.compile(r"^\s*(?:[-*]|\d+\.)\s+")
_SENTENCE_END = re.compile(r"(?<=[.!?])[)\"*_]*\s+(?=[\"(*_`\[]*(?:[A-Z0-9`]|fluxbench))")


def sentences(markdown: str) -> Iterator[str]:
    """The sentences of a page, without code blocks, tables, headings and pictures; inline code is one word."""
    for paragraph in _paragraphs(markdown):
        text = re.sub(r"`[^`]*`", "Code", paragraph)
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
        yield from _SENTENCE_END.split(text)


def words(sentence: str) -> list[str]:
    """Its words; numbers and signs are none."""
    return [word for word in sentence.split() if re.search(r"[A-Za-z]{2}|\ba\b", word)]


def _paragraphs(markdown: str) -> Iterator[str]:
    """Paragraphs and items of lists, each on one line."""
    text = re.sub(r"^```.*?^```$", "", markdown, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    lines: list[str] = []
    for line in [*text.splitlines(), ""]:
        if re.match(r"\s*(\||#|!\[|$)| {4,}", line):
            if lines:
                yield " ".join(lines)
            lines = []
            continue
        if _MARK.match(line) and lines:
            yield " ".join(lines)
            lines = []
        lines.append(_MARK.sub("", line).strip())


def test_sentences_leave_out_code_and_tables_and_keep_items_apart() -> None:
    code = "```x\nnot this.\n```\n| no | table |\n\n    nor this\n"
    page = f"# Title\n\nOne `a b c` two. Three\nfour.\n\n{code}\n- five\n- six\n"
    assert list(sentences(page)) == ["One Code two.", "Three four.", "five", "six"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_sentence_of_a_page_is_too_long(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    long = [f"{len(words(s))} words: {s}" for s in sentences(text) if len(words(s)) > MAX_WORDS]
    assert long == [], "\n".join(long)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_has_no_word_of_the_dialect(page: Path) -> None:
    found = [line for line in page.read_text(encoding="utf-8").splitlines() if DIALECT.search(line)]
    assert found == []
