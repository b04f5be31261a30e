"""Decision records: each states a decision in three sections, and whatever refers to one finds it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "decisions"
RECORDS = sorted(FOLDER.glob("[0-9]*.md"))
SECTIONS = ["Context", "Decision", "Consequences"]
NO_STATEMENT = {"What", "How", "Whose", "By", "On", "Of", "Between"}
"""First words of a title that names a subject and states no decision."""
MAX_BODY_LINES = 45
MAX_SENTENCE_WORDS = 25

MARKDOWN_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
FILE_MENTION = re.compile(r"decisions/(\d{4})")
NUMBER_MENTION = re.compile(r"\b[Dd]ecision (\d+)\b")


def title_of(record: Path) -> str:
    """The first line without its mark: number and sentence."""
    return record.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def body_of(record: Path) -> str:
    """All that follows the title."""
    return record.read_text(encoding="utf-8").partition("\n")[2].strip()


def sentences(text: str) -> Iterator[str]:
    """The sentences of a text's paragraphs and list entries; headings are none."""
    for paragraph in re.split(r"\n\n|\n(?=- )", text):
        if not paragraph.startswith("#"):
            yield from re.split(r"(?<=[.?!])\s+", " ".join(paragraph.split()))


def pages_that_link_to_records() -> Iterator[Path]:
    """The README and every page outside the records."""
    yield ROOT / "README.md"
    yield from (page for page in (ROOT / "docs").rglob("*.md") if page.parent != FOLDER)


def files_that_mention_records() -> Iterator[Path]:
    """Code, tests and pages that are written by hand."""
    yield from pages_that_link_to_records()
    for room in ("fluxbench", "orchestrator", "plugins", "protocols", "tests"):
        yield from (file for file in (ROOT / room).rglob("*.py") if file != Path(__file__))


def test_records_are_numbered_without_gaps() -> None:
    assert [record.name[:4] for record in RECORDS] == [f"{n:04d}" for n in range(1, len(RECORDS) + 1)]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_title_states_the_decision(record: Path) -> None:
    number, _, sentence = title_of(record).partition(". ")
    assert number == str(int(record.name[:4]))
    assert sentence.split()[0] not in NO_STATEMENT
    assert len(sentence.split()) > 2
    assert not sentence.endswith(".")


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_record_has_its_three_sections_in_order_on_half_a_page(record: Path) -> None:
    body = body_of(record)
    assert re.findall(r"^#+ (.*)$", body, flags=re.MULTILINE) == SECTIONS
    assert all(text.strip() for text in re.split(r"^## .*$", body, flags=re.MULTILINE)[1:])
    assert body.count("\n") < MAX_BODY_LINES


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_record_s_sentences_are_short(record: Path) -> None:
    assert [s for s in sentences(body_of(record)) if len(s.split()) > MAX_SENTENCE_WORDS] == []


def test_the_index_has_every_record_once_by_its_title() -> None:
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    entries = re.findall(r"^- \[(.+)\]\((.+)\)$", index, flags=re.MULTILINE)
    by_number = sorted(entries, key=lambda entry: entry[1])
    assert by_number == [(title_of(record), record.name) for record in RECORDS]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_record_s_links_resolve(record: Path) -> None:
    links = MARKDOWN_LINK.findall(record.read_text(encoding="utf-8"))
    assert [link for link in links if "://" not in link and not (FOLDER / link).is_file()] == []


def test_a_page_s_links_to_records_resolve() -> None:
    links = [
        (page, link)
        for page in pages_that_link_to_records()
        for link in MARKDOWN_LINK.findall(page.read_text(encoding="utf-8"))
        if "decisions/" in link
    ]
    assert len(links) > 3
    assert [f"{page.name}: {link}" for page, link in links if not (page.parent / link).is_file()] == []


def test_a_record_that_is_mentioned_exists() -> None:
    numbers = {int(record.name[:4]) for record in RECORDS}
    found = 0
    for file in files_that_mention_records():
        text = file.read_text(encoding="utf-8")
        mentioned = {int(n) for pattern in (FILE_MENTION, NUMBER_MENTION) for n in pattern.findall(text)}
        assert mentioned <= numbers, file.relative_to(ROOT)
        found += len(mentioned)
    assert found > 3
