"""Publishes a run's messages to the streams without blocking.

Each stream runs on its own thread behind a bounded queue that drops its oldest entry; its exceptions
are counted and reported at the end. A failing viewer never affects the run.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import TypeVar

from orchestrator.formatting.sentences import cut, visible
from orchestrator.operating_system.signals import STOP_SIGNALS, handlers
from protocols import Message, SamplesCaptured, Stream

T = TypeVar("T")

_THREAD_PREFIX = "stream "
"""Prefix of the streams' thread names."""


@dataclass(frozen=True)
class StreamTally:
    """Delivery statistics of a stream."""

    name: str
    delivered: int
    dropped: int
    errors: int
    first_error: str
    closed: bool
    """Whether it ended in time."""
    notes: tuple[str, ...] = ()
    """The stream's own attribute `notes` at its end, if any."""

    @property
    def has_failed(self) -> bool:
        """Whether some of its output may be missing."""
        return self.errors > 0 or not self.closed

    @property
    def trouble(self) -> str:
        """All its problems in one line; empty without any."""
        if not (self.has_failed or self.dropped or self.notes):
            return ""
        counted = f"{self.delivered} delivered, {self.dropped} dropped, {self.errors} errors"
        first = f" (first: {self.first_error})" if self.first_error else ""
        problems = [counted + first] if self.has_failed or self.dropped else []
        return f"stream {self.name}: {'; '.join([*problems, *self.notes])}"


def has_unfinished_streams() -> bool:
    """Whether a thread of an abandoned stream still runs in this process."""
    return any(thread.name.startswith(_THREAD_PREFIX) for thread in threading.enumerate())


class Dispatcher:
    """Owner of the streams' threads.

    Parameters
    ----------
    streams : mapping of str to callable
        Name and factory of each stream; the factory is called on the stream's thread.
    capacity : int
        Length of each queue.
    """

    def __init__(self, streams: Mapping[str, Callable[[], Stream]], capacity: int = 512) -> None:
        self._listeners = [_Listener(name, make, capacity) for name, make in streams.items()]
        for listener in self._listeners:
            listener.start()

    def publish(self, message: Message) -> None:
        """Queue the message for every stream; takes microseconds, never blocks, never raises."""
        for listener in self._listeners:
            listener.put(message)

    def drain(self, timeout_s: float) -> None:
        """Wait until all published messages are delivered, or until the timeout."""
        deadline = time.monotonic() + timeout_s
        for listener in self._listeners:
            listener.drain(deadline)

    def close(
        self, timeout_s: float = 60.0, tell: Callable[[str], None] | None = None, silent_s: float = 1.0
    ) -> Sequence[StreamTally]:
        """Deliver what is queued, close the streams, and return the statistics of each.

        A delay beyond `silent_s` is reported, by default on standard error where that is a terminal. A stop
        signal (Ctrl-C) ends the waiting: streams that are still at work are left unfinished.
        """
        for listener in self._listeners:
            listener.put(None)
        now = time.monotonic()
        with _stop_signals() as is_given_up:
            late = [one for one in self._listeners if not one.wait(min(now + silent_s, now + timeout_s), is_given_up)]
            if late and not is_given_up():
                (tell or _tell)(f"closing {', '.join(one.name for one in late)} (Ctrl-C leaves it unfinished)")
            for listener in late:
                listener.wait(now + timeout_s, is_given_up)
        return [listener.tally() for listener in self._listeners]


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Whether a stop signal came since the block began; restores the previous handlers."""
    stop_event = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        stop_event.set()

    if threading.current_thread() is not threading.main_thread():
        yield stop_event.is_set  # signals are the main thread's alone
        return
    with handlers(dict.fromkeys(STOP_SIGNALS, stop)):
        yield stop_event.is_set


def _tell(line: str) -> None:
    with suppress(OSError, ValueError):  # the terminal may be gone
        if sys.stderr.isatty():
            print(visible(cut(f"fluxbench: {line}")), file=sys.stderr, flush=True)


class _Listener:
    """One stream, its queue and its thread."""

    def __init__(self, name: str, make: Callable[[], Stream], capacity: int) -> None:
        self.name, self._make, self._capacity = name, make, capacity
        self._queue: deque[Message | None] = deque()
        self._changed = threading.Condition()
        self._busy = True
        self._wants_samples = True
        self._delivered = self._dropped = self._errors = 0
        self._first_error = ""
        self._notes: tuple[str, ...] = ()
        self._thread = threading.Thread(target=self._work, name=f"{_THREAD_PREFIX}{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, message: Message | None) -> None:
        if isinstance(message, SamplesCaptured) and not self._wants_samples:
            return
        with self._changed:
            if len(self._queue) >= self._capacity:
                self._queue.popleft()
                self._dropped += 1
            self._queue.append(message)
            self._changed.notify_all()

    def drain(self, deadline: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: not self._queue and not self._busy, max(0.0, deadline - time.monotonic()))

    def wait(self, deadline: float, is_given_up: Callable[[], bool]) -> bool:
        """Whether the stream came to its end before the deadline, and before it was given up."""
        while self._thread.is_alive() and time.monotonic() < deadline and not is_given_up():
            self._thread.join(min(0.05, max(0.0, deadline - time.monotonic())))
        return not self._thread.is_alive()

    def tally(self) -> StreamTally:
        is_closed = not self._thread.is_alive()
        return StreamTally(
            name=self.name,
            delivered=self._delivered,
            dropped=self._dropped,
            errors=self._errors,
            first_error=self._first_error,
            closed=is_closed,
            notes=self._notes if is_closed else ("was left unfinished",),
        )

    def _next(self) -> Message | None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: bool(self._queue))
            self._busy = True
            return self._queue.popleft()

    def _work(self) -> None:
        stream = self._guarded(self._make)
        self._wants_samples = stream is not None and stream.wants_samples
        while (message := self._next()) is not None:
            if stream is None:
                self._dropped += 1
                continue
            errors_before = self._errors
            self._guarded(partial(stream.receive, message))
            self._delivered += self._errors == errors_before
        if stream is not None:
            self._guarded(stream.close)
            self._notes = tuple(str(note) for note in getattr(stream, "notes", ()))
        with self._changed:
            self._busy = False
            self._changed.notify_all()

    def _guarded(self, call: Callable[[], T]) -> T | None:
        try:
            return call()
        except (Exception, SystemExit) as error:  # third-party code: its exceptions must not reach the run
            self._errors += 1
            self._first_error = self._first_error or f"{type(error).__name__}: {error}"
            return None
