"""Borrowed sentences get the characters of a printed page, or those that an output has, and nothing else changes."""

from __future__ import annotations

import io
import json
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.formatting.sentences import (
    can_print,
    columns,
    cut,
    for_output,
    listed,
    markdown_table,
    one_line,
    shortened,
    text_table,
    typographic,
    visible,
)


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("moved -0.21 +- 0.05 deg", "moved −0.21 ± 0.05 deg"),
        ("error 350 -> 4.2 mV", "error 350 → 4.2 mV"),
        ("R_s 4.31 ohm, 95 % 4.30..4.32", "R_s 4.31 Ω, 95 % 4.30 to 4.32"),
        ("95 % -0.4..-0.2", "95 % −0.4 to −0.2"),
        ("1.48e+03 mV", "1480 mV"),
        ("2.5e-07 1/W", "2.5·10⁻⁷ 1/W"),
        ("5.489e+04", "54890"),
        ("3e+09", "3·10⁹"),
        ("worst in injection-031", "worst in injection-031"),
        ("2026-11-21", "2026-11-21"),
        ("gates-off, see map-2.nc", "gates-off, see map-2.nc"),
        ("0x1e5 and abc1e5", "0x1e5 and abc1e5"),
    ],
)
def test_sentences_get_print_characters(plain: str, printed: str) -> None:
    assert typographic(plain) == printed


@given(st.text(alphabet=st.characters(categories=["L", "Zs"])))
def test_words_stay_as_they_are(text: str) -> None:
    assert typographic(text) == text


def test_an_output_gets_what_its_encoding_can_take() -> None:
    plain = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    assert not can_print(plain)
    text = "20.00 mΩ, −3 ± 2 µV, 0.1 per A², ψ, 2.4·10⁻⁵, λ"
    assert for_output(text, plain) == "20.00 mohm, -3 +- 2 uV, 0.1 per A^2, psi, 2.4*10^-5, ?"
    whole = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    assert for_output("20.00 mΩ", whole) == "20.00 mΩ"


@given(st.text())
def test_a_line_is_one_line(text: str) -> None:
    assert one_line(text).isprintable()


def test_a_long_sentence_is_cut_between_words() -> None:
    short = shortened("alpha = 1, beta = 2, gamma = 3", 20)
    assert short == "alpha = 1, beta ... (in full in the report)"
    assert shortened("short", 20) == "short"


def test_names_are_listed_as_one_speaks() -> None:
    assert [listed(list("abc")[:n]) for n in range(4)] == ["", "a", "a and b", "a, b and c"]


def test_tables_have_columns() -> None:
    assert text_table(("stage", "rms"), [("all", "3 mV")]) == "stage   rms\n-----  ----\nall    3 mV"
    assert columns([("a", "b"), ("ccc", "d")]) == ["a    b", "ccc  d"]
    assert columns([]) == []
    assert markdown_table(("x",), [("a|b",)]) == "| x |\n| --- |\n| a/b |"


TURNING = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}


def is_obeyed(char: str) -> bool:
    """Whether a terminal or a page does something at this character, by Unicode's own tables."""
    turns = unicodedata.bidirectional(char) in TURNING or char in "\u061c\u200e\u200f"
    return char != "\n" and (turns or unicodedata.category(char) in ("Cc", "Cs", "Zl", "Zp"))


def test_of_all_characters_those_that_are_obeyed_are_written_out() -> None:
    for code in range(0x110000):
        char = chr(code)
        assert (visible(char) != char) == is_obeyed(char), hex(code)


@given(st.text(st.characters(), max_size=50))
def test_what_is_made_visible_reads_the_same_in_json(text: str) -> None:
    document = json.dumps({"name": text}, ensure_ascii=False)
    assert json.loads(visible(document)) == {"name": text}


def test_a_line_from_outside_is_cut_and_says_how_long_it_was() -> None:
    assert cut("short\n" + "x" * 10_000_000, 5) == "short\nxxxxx... (10000000 characters)"
    assert cut("x" * 4000) == "x" * 4000
