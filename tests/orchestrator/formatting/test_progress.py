"""A terminal shows the current step at most once a second; files and pipes every ten seconds."""

from __future__ import annotations

from io import StringIO

from orchestrator.formatting.progress import Progress


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def printed(where: StringIO, words: list[tuple[float, str]]) -> list[str]:
    now = [0.0]
    progress = Progress(where, lambda: now[0])
    for now[0], text in words:
        progress(text)
    return [line.split("  ")[-1] for line in where.getvalue().splitlines()]


def test_no_more_than_a_line_a_second() -> None:
    assert printed(Terminal(), [(0.0, "one"), (0.3, "two"), (0.9, "three"), (1.1, "four")]) == ["one", "four"]


def test_an_added_effect_is_printed_at_once() -> None:
    assert printed(Terminal(), [(0.0, "one"), (0.1, "+ dead time"), (0.2, "+ eddy currents")])[1:] == [
        "+ dead time",
        "+ eddy currents",
    ]


def test_a_file_gets_a_step_every_ten_seconds_with_the_time_that_is_left() -> None:
    steps = [(0.0, "one"), (2.0, "+ dead time"), (11.0, "search (some 30 s more)"), (12.0, "three"), (21.5, "four")]
    assert printed(StringIO(), steps) == ["search (some 30 s more)", "four"]


def test_a_result_is_printed_at_once_at_a_terminal() -> None:
    where, results, now = Terminal(), StringIO(), [0.0]
    progress = Progress(where, lambda: now[0], results)
    progress("one")
    now[0] = 0.4
    progress.result("so far: dead time")
    now[0] = 12.2
    progress("two")
    assert where.getvalue().splitlines() == ["    0 s  one", "    0 s  so far: dead time", "   12 s  two"]
    assert results.getvalue() == ""


def test_in_a_file_a_result_is_the_only_line() -> None:
    where, results = StringIO(), StringIO()
    progress = Progress(where, results=results)
    progress("one")
    progress.result("so far: dead time")
    assert (where.getvalue(), results.getvalue()) == ("", "so far: dead time\n")
    alone = Progress(where)
    alone.result("the model alone")
    assert where.getvalue() == "the model alone\n"
