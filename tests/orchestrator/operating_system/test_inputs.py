"""Waiting for a pipe ends with its data, with its end, or with the time."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from orchestrator.operating_system.inputs import wait_for_input


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for end in ends:
        try:
            os.close(end)
        except OSError:
            continue


@pytest.mark.usefixtures("system")
def test_a_silent_pipe_is_waited_for_no_longer_than_said(pipe: tuple[int, int]) -> None:
    assert not wait_for_input(pipe[0], 0.05)


@pytest.mark.usefixtures("system")
def test_data_and_the_end_of_a_pipe_are_input(pipe: tuple[int, int]) -> None:
    os.write(pipe[1], b"yes")
    assert wait_for_input(pipe[0], 1.0)
    assert os.read(pipe[0], 10) == b"yes"
    os.close(pipe[1])
    assert wait_for_input(pipe[0], 1.0)
    assert os.read(pipe[0], 10) == b""
