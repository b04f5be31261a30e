"""Who waits at a terminal is told what is under way, no oftener than can be read; nobody else is."""

from __future__ import annotations

from io import StringIO

from orchestrator.formatting.waiting import Waiting


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


def test_what_is_to_be_kept_is_said_at_once_at_a_terminal() -> None:
    where, kept, now = Terminal(), StringIO(), [0.0]
    waiting = Waiting(where, lambda: now[0], kept)
    waiting("one")
    now[0] = 0.4
    waiting.keep("so far: dead time")
    now[0] = 12.2
    waiting("two")
    assert where.getvalue().splitlines() == ["    0 s  one", "    0 s  so far: dead time", "   12 s  two"]
    assert kept.getvalue() == ""


def test_in_a_file_it_is_a_plain_line_and_the_only_one() -> None:
    where, kept = StringIO(), StringIO()
    waiting = Waiting(where, kept=kept)
    waiting("one")
    waiting.keep("so far: dead time")
    assert (where.getvalue(), kept.getvalue()) == ("", "so far: dead time\n")
    alone = Waiting(where)
    alone.keep("the model alone")
    assert where.getvalue() == "the model alone\n"
