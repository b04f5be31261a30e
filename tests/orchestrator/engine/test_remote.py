"""A person at the other end of a pipe: answers arrive, stops stop, and an end or a silence of the pipe does too."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from orchestrator.engine import Interrupts, RemoteOperator
from protocols import RunInterrupted


class Page:
    """The other end."""

    def __init__(self, silence_s: float = 30.0) -> None:
        reading, self.writing = os.pipe()
        self.reading = reading
        self.interrupts = Interrupts()
        self.operator = RemoteOperator("page", reading, silence_s)

    def write(self, message: Any) -> None:
        os.write(self.writing, (message if isinstance(message, bytes) else json.dumps(message).encode()) + b"\n")

    def ends_within(self, seconds: float = 5.0) -> str:
        """Why the run has to end."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                self.interrupts.check()
            except RunInterrupted as error:
                return str(error)
            time.sleep(0.01)
        return ""


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def listening(stack: ExitStack, silence_s: float = 30.0) -> Page:
    page = Page(silence_s)
    stack.enter_context(page.operator.listening(page.interrupts))
    return page


@pytest.mark.parametrize(("answer", "agreed"), [("yes", True), ("no", False)])
def test_an_answer_to_the_question_counts(answer: str, agreed: bool, stack: ExitStack) -> None:
    page = listening(stack)
    page.write({"answer": answer, "question": "Engage the brake"})
    assert page.operator.confirm("Engage the brake", page.interrupts) is agreed


def test_answers_to_other_questions_and_words_that_are_none_are_passed_over(stack: ExitStack) -> None:
    page = listening(stack)
    page.write({"answer": "yes", "question": "Release the brake"})
    page.write({"answer": "perhaps", "question": "Engage the brake"})
    page.write(b"[1, 2")
    page.write(b'["yes"]')
    page.write({"answer": "no", "question": "Engage the brake"})
    assert page.operator.confirm("Engage the brake", page.interrupts) is False


def test_a_line_may_come_in_pieces(stack: ExitStack) -> None:
    page = listening(stack)
    os.write(page.writing, b'{"stop": "enough')
    time.sleep(0.05)
    os.write(page.writing, b' of it"}\n')
    assert page.ends_within() == "enough of it"


def test_a_stop_ends_a_question_as_well(stack: ExitStack) -> None:
    page = listening(stack)
    page.write({"stop": "enough"})
    with pytest.raises(RunInterrupted, match="enough"):
        page.operator.confirm("Engage the brake", page.interrupts)


def test_a_page_that_is_gone_ends_the_run(stack: ExitStack) -> None:
    page = listening(stack)
    os.close(page.writing)
    assert page.ends_within() == "the operator's page is gone"


def test_a_page_that_hangs_ends_the_run(stack: ExitStack) -> None:
    page = listening(stack, silence_s=0.3)
    assert page.ends_within() == "the operator's page has been silent for 0.3 s"


def test_a_page_that_says_now_and_then_that_it_is_there_keeps_the_run(stack: ExitStack) -> None:
    page = listening(stack, silence_s=2.0)
    for _ in range(12):
        page.write({})
        assert page.ends_within(0.25) == ""
