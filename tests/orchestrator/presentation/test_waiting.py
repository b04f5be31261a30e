"""Who waits at a terminal is told what is under way, no oftener than can be read; nobody else is."""

from __future__ import annotations

from io import StringIO

from orchestrator.presentation.waiting import Waiting


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def said(where: StringIO, words: list[tuple[float, str]]) -> list[str]:
    now = [0.0]
    waiting = Waiting(where, lambda: now[0])
    for now[0], text in words:
        waiting(text)
    return [line.split("  ")[-1] for line in where.getvalue().splitlines()]


def test_no_more_than_a_line_a_second() -> None:
    assert said(Terminal(), [(0.0, "one"), (0.3, "two"), (0.9, "three"), (1.1, "four")]) == ["one", "four"]


def test_what_was_found_is_said_at_once() -> None:
    assert said(Terminal(), [(0.0, "one"), (0.1, "+ dead time"), (0.2, "+ eddy currents")])[1:] == [
        "+ dead time",
        "+ eddy currents",
    ]


def test_a_file_gets_nothing() -> None:
    assert said(StringIO(), [(0.0, "one"), (2.0, "+ dead time")]) == []
