"""Streams cost the run nothing: bounded queues, counted drops, errors kept on their side."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest
from pydantic import BaseModel

from orchestrator.engine.streaming import Dispatcher, has_unfinished_streams
from protocols import Capture, Message, NoOptions, Note, SamplesCaptured, StreamSetup
from tests.support.processes import wait_until


class Listening:
    """Remembers what it was reported."""

    name: ClassVar[str] = "listening"
    Options: ClassVar[type[BaseModel]] = NoOptions
    wants_samples: ClassVar[bool] = False

    def __init__(self, setup: StreamSetup | None = None) -> None:
        self.received: list[Message] = []
        self.closed = False
        self.thread = threading.current_thread()

    def receive(self, message: Message) -> None:
        self.received.append(message)

    def close(self) -> None:
        self.closed = True


class Stalled(Listening):
    """A viewer that does not answer."""

    def __init__(self, release: threading.Event) -> None:
        super().__init__()
        self._release = release

    def receive(self, message: Message) -> None:
        self._release.wait()
        super().receive(message)


class Failing(Listening):
    def receive(self, message: Message) -> None:
        raise ValueError("no display")


def note(text: str) -> Note:
    return Note(level="info", text=text)


def texts(stream: Listening) -> list[str]:
    return [message.text for message in stream.received if isinstance(message, Note)]


def waits(dispatcher: Dispatcher) -> None:
    dispatcher.drain(timeout_s=5.0)


def test_messages_arrive_in_order_on_the_streams_own_thread() -> None:
    stream = Listening()
    dispatcher = Dispatcher({"a": lambda: stream})
    for k in range(100):
        dispatcher.publish(note(str(k)))
    (tally,) = dispatcher.close()
    assert texts(stream) == [str(k) for k in range(100)]
    assert stream.closed
    assert (tally.delivered, tally.dropped, tally.errors, tally.closed) == (100, 0, 0, True)


def test_a_stalled_stream_neither_blocks_the_run_nor_the_other_streams() -> None:
    release = threading.Event()
    stalled, listening = Stalled(release), Listening()
    dispatcher = Dispatcher({"stalled": lambda: stalled, "listening": lambda: listening}, capacity=10)
    slowest = 0.0
    for k in range(1000):
        begun = time.perf_counter()
        dispatcher.publish(note(str(k)))
        slowest = max(slowest, time.perf_counter() - begun)
        if k % 5 == 0:
            time.sleep(0.0002)
    waits_for_others(listening)
    release.set()
    tallies = {tally.name: tally for tally in dispatcher.close()}
    assert slowest < 0.2
    assert tallies["stalled"].dropped >= 900
    assert texts(stalled)[-1] == "999"
    assert tallies["stalled"].delivered + tallies["stalled"].dropped == 1000


def waits_for_others(listening: Listening) -> None:
    deadline = time.monotonic() + 5
    while (not texts(listening) or texts(listening)[-1] != "999") and time.monotonic() < deadline:
        time.sleep(0.005)
    assert texts(listening)[-1] == "999"


def test_a_stream_that_never_returns_is_left_behind_at_the_end() -> None:
    release = threading.Event()
    dispatcher = Dispatcher({"stalled": lambda: Stalled(release)})
    dispatcher.publish(note("hello"))
    begun = time.monotonic()
    (tally,) = dispatcher.close(timeout_s=0.2)
    release.set()
    assert not tally.closed
    assert time.monotonic() - begun < 2.0


def test_what_a_stream_raises_is_counted_and_reported() -> None:
    dispatcher = Dispatcher({"failing": Failing})
    dispatcher.publish(note("a"))
    dispatcher.publish(note("b"))
    (tally,) = dispatcher.close()
    assert (tally.delivered, tally.errors, tally.first_error) == (0, 2, "ValueError: no display")


def test_a_stream_that_cannot_be_made_is_reported_and_loses_everything() -> None:
    def refuse() -> Listening:
        raise RuntimeError("no such terminal")

    make: Callable[[], Listening] = refuse
    dispatcher = Dispatcher({"broken": make})
    dispatcher.publish(note("a"))
    (tally,) = dispatcher.close()
    assert (tally.dropped, tally.errors) == (1, 1)
    assert "no such terminal" in tally.first_error


@pytest.mark.parametrize("wanted", [True, False])
def test_samples_go_only_where_they_are_wanted(wanted: bool) -> None:
    class Choosing(Listening):
        wants_samples: ClassVar[bool] = wanted

    stream = Choosing()
    dispatcher = Dispatcher({"a": lambda: stream})
    waits(dispatcher)
    zeros = np.zeros((2, 2))
    capture = Capture(start_s=0.0, sampling_frequency_hz=1e4, i_ab=zeros, v_ab=zeros, v_dc=np.zeros(2))
    dispatcher.publish(SamplesCaptured(segment="hold-000", rotor_angle_rad=0.0, capture=capture))
    dispatcher.publish(note("end"))
    dispatcher.close()
    assert [message.kind for message in stream.received] == (["samples_captured", "note"] if wanted else ["note"])


def test_a_drained_dispatcher_has_delivered_everything() -> None:
    stream = Listening()
    dispatcher = Dispatcher({"a": lambda: stream})
    dispatcher.publish(note("question follows"))
    waits(dispatcher)
    assert texts(stream) == ["question follows"]
    dispatcher.close()


class Slow(Listening):
    """A stream that takes its time to close."""

    def __init__(self, release: threading.Event) -> None:
        super().__init__()
        self._release = release

    def close(self) -> None:
        self._release.wait(10.0)


def test_closing_that_takes_long_is_reported_and_only_then() -> None:
    reported: list[str] = []
    release = threading.Event()

    def tell(line: str) -> None:
        reported.append(line)
        release.set()

    quick = Dispatcher({"quick": Listening}).close(tell=tell)
    assert reported == []
    slow = Dispatcher({"report": lambda: Slow(release), "quick": Listening}).close(tell=tell, silent_s=0.1)
    assert len(reported) == 1
    assert "report" in reported[0]
    assert "quick" not in reported[0]
    assert all(tally.closed for tally in (*quick, *slow))


def test_a_stop_signal_ends_the_closing_and_its_handler_is_put_back() -> None:
    release = threading.Event()
    others = set(threading.enumerate())  # of tests before, in this process
    before = signal.getsignal(signal.SIGINT)
    begun = time.monotonic()
    dispatcher = Dispatcher({"report": lambda: Slow(release)})
    (tally,) = dispatcher.close(tell=lambda line: signal.raise_signal(signal.SIGINT), silent_s=0.1)
    assert time.monotonic() - begun < 3.0
    assert not tally.closed
    assert tally.notes == ("was left unfinished",)
    assert tally.trouble == "stream report: 0 delivered, 0 dropped, 0 errors; was left unfinished"
    assert signal.getsignal(signal.SIGINT) is before
    assert has_unfinished_streams()
    release.set()
    wait_until(lambda: others >= set(threading.enumerate()))


LEAVING = """
import atexit, threading, time
from orchestrator.interface.cli._process import leave
from orchestrator.engine.streaming import Dispatcher, has_unfinished_streams
{stream}
atexit.register(time.sleep, 60.0)  # as a library that waits for its own thread
print("all stated")
leave(3)
"""
STUCK = "Dispatcher({'stuck': threading.Event().wait}).close(timeout_s=0.1)"


def test_a_process_ends_though_the_library_of_a_stream_that_was_given_up_waits_for_it() -> None:
    words = [sys.executable, "-c", LEAVING.replace("{stream}", STUCK)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=20.0, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "all stated\n", "")
