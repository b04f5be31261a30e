"""Sentences and tables as text: the characters of a printed page, lines without control characters, columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TextIO

from orchestrator.formatting.quantities import number

MAX_LINE_LENGTH = 4000
"""Characters of a line for people; longer texts are external."""
_CONTROL_CHARACTERS = re.compile(
    r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
_ASCII = str.maketrans(
    {
        "Ω": "ohm",
        "Δ": "delta ",
        "µ": "u",
        "−": "-",
        "–": "-",
        "×": "x",
        "━": "=",
        "→": "->",
        "±": "+-",
        "·": "*",
        "°": " deg",
        "√": "sqrt ",
        "ψ": "psi",
    }
)
_EXPONENT = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")
_PLAIN_DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_POWER = re.compile(r"(?<![\w.])(\d(?:\.\d+)?)e[+-]?\d+\b")
_REPLACED = (
    (re.compile(r"\+-|\+/-"), "±"),
    (re.compile(r"\s->\s"), " → "),
    (re.compile(r"(?<=[\d.])\s?\.\.\s?(?=[-−\d])"), " to "),
    (re.compile(r"(?<![\w.\-−)/])-(?=\.?\d)"), "−"),
    (re.compile(r"(?<=\d )ohm\b"), "Ω"),
)


def typographic(text: str) -> str:
    """A sentence with printed characters: ±, →, true minus signs before numbers, Ω, powers of ten spelt out."""
    text = _POWER.sub(lambda match: number(float(match[0]), len(match[1].replace(".", ""))), text)
    for pattern, by in _REPLACED:
        text = pattern.sub(by, text)
    return text


def listed(names: Sequence[str]) -> str:
    """a; a and b; a, b and c."""
    return " and ".join(names) if len(names) < 3 else ", ".join(names[:-1]) + " and " + names[-1]


def one_line(text: str) -> str:
    """External text on one line without control characters, safe for a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def visible(text: str) -> str:
    r"""The text with every control character written as ``\u001b``.

    Control characters (C0 but for the line feed, DEL, C1), marks that turn the direction of writing (UAX #9),
    separators of lines and paragraphs, and halves of surrogate pairs. JSON stays the same JSON.
    """
    return _CONTROL_CHARACTERS.sub(lambda match: f"\\u{ord(match[0]):04x}", text)


def cut(text: str, length: int = MAX_LINE_LENGTH) -> str:
    """Each line of an external text with at most so many characters, and its original length where it is longer."""
    if len(text) <= length:
        return text
    lines = text.split("\n")
    return "\n".join(line if len(line) <= length else f"{line[:length]}... ({len(line)} characters)" for line in lines)


def shown(text: str) -> str:
    """External text, safe to print or draw: without control characters, and with lines of limited length."""
    return visible(cut(text))


def shortened(text: str, length: int) -> str:
    """At most so many characters, cut between words."""
    if len(text) <= length:
        return text
    return text[:length].rsplit(" ", 1)[0].rstrip(" ,;:=±") + " ... (in full in the report)"


def can_print(output: TextIO) -> bool:
    """Whether an output's encoding has the characters of quantities and live displays."""
    try:
        "Ωµ−×✓━⠋".encode(output.encoding or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def for_output(text: str, output: TextIO) -> str:
    """The text in the output's encoding, without control characters."""
    text = visible(text)
    if can_print(output):
        return text
    text = _EXPONENT.sub(lambda digits: "^" + digits[0].translate(_PLAIN_DIGITS), text)
    return text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


def columns(lines: Sequence[Sequence[str]], numbers: bool = False) -> list[str]:
    """Rows in columns of minimal width; with `numbers`, all but the first align right."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    line = "  ".join(f"{{:{'>' if numbers and k else '<'}{width}}}" for k, width in enumerate(widths))
    return [line.format(*cells).rstrip() for cells in lines]


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: bool = True) -> str:
    """A table for a terminal, its head underlined."""
    lines = columns([head, *rows], numbers)
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return "\n".join([lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(one_line(cell.replace("|", "/")) for cell in line) + " |" for line in lines)
