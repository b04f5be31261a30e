"""The stream's conformance kit. What a stream shows, and how well, is a question for the plugin's own tests."""

from __future__ import annotations

import errno
import io
import random
import sys
import threading
import time
import tracemalloc
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, TypeVar, cast

import pytest
from pydantic import BaseModel

from orchestrator.testing._kit import Kit, bounded
from orchestrator.testing._messages import a_manifest, a_run, one_of_each, points_done, samples
from orchestrator.testing._stream_bench import OPENED_FILES, Worker, digest, left_elsewhere
from protocols import Message, NoOptions, Stream, StreamSetup

T = TypeVar("T")

CALL_TIMEOUT_S = 20.0
THREAD_END_TIMEOUT_S = 5.0


class StreamConformance(Kit, ABC):
    """Checks that a stream plugin keeps the contract of `protocols.Stream`.

    Subclass it in a test file, in a class whose name begins with ``Test``, and give one method,
    ``make_stream(setup)``; override ``options()`` where the stream has options of its own.
    """

    receive_s: ClassVar[float] = 0.05
    """Median time for a typical message; at most 0.2."""
    growth_bytes: ClassVar[float] = 4e6
    """Memory that a thousand messages may leave behind; at most 2e7."""

    @abstractmethod
    def make_stream(self, setup: StreamSetup) -> Stream:
        """A new stream."""

    def options(self) -> BaseModel:
        """The stream's own options."""
        return NoOptions()

    _hung: ClassVar[str] = ""
    """Calls that hung before: later checks do not wait for them again."""

    @contextmanager
    def _listening(self, tmp_path: Path) -> Iterator[tuple[_Timed, Path]]:
        """A stream on a run directory with a manifest and a journal; closed at the end, with no thread left of it."""
        if type(self)._hung:
            pytest.fail(f"{type(self)._hung}, in another check")
        run = tmp_path / "run"
        run.mkdir()
        (run / "recording.json").write_text(a_manifest().model_dump_json(), encoding="utf-8")
        (run / "journal.jsonl").write_text("", encoding="utf-8")
        before = set(threading.enumerate())
        worker = Worker()
        setup = StreamSetup(run=run, options=self.options())
        stream = self._in_time(worker, "making it", lambda: self.make_stream(setup))
        try:
            yield _Timed(stream, lambda what, call: self._in_time(worker, what, call)), run
        finally:
            if not type(self)._hung:
                self._in_time(worker, "close", stream.close)
            worker.end()
        left = _threads_left(before | {worker.thread})
        assert not left, f"a thread is still at work after close: {', '.join(left)}"

    def _in_time(self, worker: Worker, what: str, call: Callable[[], T]) -> T:
        try:
            return cast("T", worker.call(call, CALL_TIMEOUT_S))
        except TimeoutError:
            type(self)._hung = f"it hangs: {what} has not returned after {CALL_TIMEOUT_S:g} s"
            pytest.fail(type(self)._hung)

    def test_entry_point_leads_to_the_stream(self, tmp_path: Path) -> None:
        with self._listening(tmp_path) as (stream, _):
            self.require_entry_point("fluxbench.streams", type(stream.stream))

    def test_class_keeps_the_contract(self, tmp_path: Path) -> None:
        with self._listening(tmp_path) as (stream, _):
            assert isinstance(stream.stream, Stream), "methods or attributes of protocols.Stream are missing"
            assert isinstance(stream.wants_samples, bool), "wants_samples must be True or False"
            assert issubclass(stream.Options, BaseModel), "Options must be a pydantic model"

    def test_takes_a_whole_run(self, tmp_path: Path) -> None:
        with self._listening(tmp_path) as (stream, run):
            messages = _wanted(stream, a_run(run))
            before = digest(messages)
            for message in messages:
                stream.receive(message)
        assert digest(messages) == before, (
            "it changed what it was shown: arrays belong to the run, and to other streams"
        )

    def test_takes_every_kind_of_message_in_any_order(self, tmp_path: Path) -> None:
        for order in range(5):
            directory = tmp_path / str(order)
            directory.mkdir()
            with self._listening(directory) as (stream, run):
                messages = _wanted(stream, one_of_each(run)) * 2
                random.Random(order).shuffle(messages)
                for message in messages:
                    stream.receive(message)

    def test_can_be_closed_without_a_message(self, tmp_path: Path) -> None:
        with self._listening(tmp_path):
            pass

    @pytest.mark.parametrize("terminal", [True, False])
    def test_does_not_hang_when_standard_output_goes_away(self, tmp_path: Path, terminal: bool) -> None:
        output = _Vanishing(terminal)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "stdout", output)
            patch.setenv("TERM", "xterm")
            self._listen_regardless(tmp_path, output)

    def _listen_regardless(self, tmp_path: Path, output: _Vanishing) -> None:
        """As a dispatcher: record a stream's exception and continue."""
        try:
            with suppress(Exception), self._listening(tmp_path) as (stream, run):
                for number, message in enumerate(_wanted(stream, a_run(run))):
                    output.is_gone = number >= 8
                    with suppress(Exception):
                        stream.receive(message)
        except (SystemExit, KeyboardInterrupt) as error:
            pytest.fail(f"raised {type(error).__name__}, which is no Exception, and ends the stream's thread")

    def test_writes_nowhere_but_in_the_run_directory(self, tmp_path: Path) -> None:
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        with pytest.MonkeyPatch.context() as patch, OPENED_FILES.watched() as opened:
            patch.chdir(elsewhere)
            with self._listening(tmp_path) as (stream, run):
                kept = {name: (run / name).read_bytes() for name in ("recording.json", "journal.jsonl")}
                for message in _wanted(stream, a_run(run)):
                    stream.receive(message)
        left = left_elsewhere(opened, run)
        assert not left, f"wrote beside the run directory: {', '.join(left)}"
        assert sorted(p.name for p in tmp_path.iterdir()) == ["elsewhere", "run"], "wrote beside the run directory"
        assert not list(elsewhere.iterdir()), (
            f"wrote into the working directory: {sorted(p.name for p in elsewhere.iterdir())}"
        )
        for name, content in kept.items():
            assert (run / name).read_bytes() == content, f"changed the run's own {name}"

    def test_memory_stays_bounded(self, tmp_path: Path) -> None:
        tracemalloc.start()
        # Stopped when the stream is closed: until then a thread of its library may still allocate, which CPython 3.11
        # does not bear (python/cpython issue 128679).
        try:
            with self._listening(tmp_path) as (stream, run):
                opening = _wanted(stream, a_run(run)[:4])
                make = samples if stream.wants_samples else points_done
                for message in [*opening, *make(run, 50)]:
                    stream.receive(message)
                before = tracemalloc.get_traced_memory()[0]
                for message in make(run, 1000):
                    stream.receive(message)
                del message
                grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        allowed = bounded("growth_bytes", self.growth_bytes, 2e7)
        assert grown <= allowed, f"{grown / 1e6:.1f} MB more after 1000 messages ({allowed / 1e6:.1f} MB allowed)"

    def test_receives_a_typical_message_quickly(self, tmp_path: Path) -> None:
        with self._listening(tmp_path) as (stream, run):
            for message in _wanted(stream, a_run(run)[:4]):
                stream.receive(message)
            make = samples if stream.wants_samples else points_done
            took = []
            for message in make(run, 41):
                begun = time.perf_counter()
                stream.receive(message)
                took.append(time.perf_counter() - begun)
        median = sorted(took)[len(took) // 2]
        allowed = bounded("receive_s", self.receive_s, 0.2)
        assert median <= allowed, f"{median * 1e3:.0f} ms for a message ({allowed * 1e3:.0f} ms allowed)"


def _wanted(stream: _Timed, messages: list[Message]) -> list[Message]:
    """The messages that a dispatcher delivers to this stream."""
    return [m for m in messages if stream.wants_samples or m.kind != "samples_captured"]


def _threads_left(known: set[threading.Thread]) -> list[str]:
    """Names of threads that are still alive some seconds later."""
    deadline = time.monotonic() + THREAD_END_TIMEOUT_S
    while left := [thread for thread in threading.enumerate() if thread not in known]:
        if time.monotonic() > deadline:
            return [thread.name for thread in left]
        time.sleep(0.02)
    return []


class _Timed:
    """A stream whose messages are delivered by one thread, and given up where it does not come back."""

    def __init__(self, stream: Stream, in_time: Callable[[str, Callable[[], None]], None]) -> None:
        self.stream, self._in_time = stream, in_time

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def receive(self, message: Message) -> None:
        self._in_time(f"receiving {message.kind!r}", lambda: self.stream.receive(message))


class _Vanishing(io.StringIO):
    """A standard output whose other end goes away."""

    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self._terminal = terminal
        self.is_gone = False

    def isatty(self) -> bool:
        return self._terminal

    def write(self, text: str) -> int:
        if self.is_gone:
            raise BrokenPipeError(errno.EPIPE, "standard output is gone")
        return super().write(text)

    def flush(self) -> None:
        if self.is_gone:
            raise BrokenPipeError(errno.EPIPE, "standard output is gone")
