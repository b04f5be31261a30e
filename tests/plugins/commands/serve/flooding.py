"""What a browser full of tabs, or a program gone wild, does to the page's server."""

from __future__ import annotations

import itertools
import random
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

from tests.plugins.commands.serve.served import Served
from tests.support.processes import wait_until


def stream_of(served: Served) -> socket.socket:
    """A connection on which an event stream was requested; nothing of it is read."""
    line = socket.create_connection(("127.0.0.1", served.port), timeout=30.0)
    request = f"GET /events HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nCookie: {served.cookie['Cookie']}\r\n\r\n"
    line.sendall(request.encode())
    return line


@contextmanager
def tabs(served: Served, count: int, rng: random.Random) -> Iterator[None]:
    """So many tabs, each opened and closed again and again, at random instants."""
    over = threading.Event()

    def tab(seed: float) -> None:
        own = random.Random(seed)
        while not over.is_set():
            with suppress(OSError), stream_of(served) as line:
                line.recv(10)
                time.sleep(own.uniform(0.0, 0.3))

    threads = [threading.Thread(target=tab, args=(rng.random(),)) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


@contextmanager
def lines(served: Served, count: int, *, silent: bool, read: bool = False) -> Iterator[list[socket.socket]]:
    """So many connections at once: silent ones, or event streams."""
    _allow_descriptors(count + 200)
    with ExitStack() as opened:
        kept = []
        for _ in range(count):
            line = socket.create_connection(("127.0.0.1", served.port), timeout=30.0) if silent else stream_of(served)
            kept.append(opened.enter_context(line))
            if read:
                with suppress(OSError):
                    line.recv(1000)
        yield kept


def _allow_descriptors(count: int) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard), hard))


class Watcher:
    """One patient reader of the events, on a thread of its own."""

    def __init__(self, served: Served) -> None:
        self.views: list[dict[str, Any]] = []
        self.arrivals_s: list[float] = []
        self._served = served
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while self._served.process.poll() is None:  # as a browser: a stream that ends is opened again
            with suppress(OSError, ValueError):
                for view in self._served.views():
                    self.views.append(view)
                    self.arrivals_s.append(time.monotonic())
            time.sleep(0.05)

    @property
    def longest_gap_s(self) -> float:
        """Between two events, the present instant included."""
        times = [*self.arrivals_s, time.monotonic()]
        return max((b - a for a, b in itertools.pairwise(times)), default=float("inf"))

    def seconds_until(self, condition: Any, timeout_s: float = 60.0) -> float:
        """Until the newest view is like that."""
        begun_s = time.monotonic()
        wait_until(lambda: bool(self.views) and bool(condition(self.views[-1])), timeout_s)
        return time.monotonic() - begun_s
