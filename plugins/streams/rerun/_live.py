"""Brings entries to a viewer, on a thread of its own, and never lets anybody wait for it.

A viewer may be absent, slow, stopped, killed, started late or again: what it has not taken waits in a bounded
queue that drops its oldest entry and counts it. One that comes (back) is given all that is still kept.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from plugins.streams.rerun._tape import Entry, new_stream

HOST = "127.0.0.1"
"""Nothing here talks to, or listens for, any other machine."""


def address(port: int) -> str:
    """Where a viewer on this machine takes data."""
    return f"rerun+http://{HOST}:{port}/proxy"


class LiveFeed:
    """Owner of the thread that feeds the viewer on `port`.

    Parameters
    ----------
    recording_id : str
        The file's, so that both are one recording.
    port : int
    capacity_bytes : float
        What may be kept for the viewer, delivered or not.
    look_again_s : float
        How often a viewer that is not there is looked for.
    """

    def __init__(self, recording_id: str, port: int, capacity_bytes: float, look_again_s: float = 0.2) -> None:
        self._look_again_s = look_again_s
        self._recording_id, self._port, self._capacity = recording_id, port, capacity_bytes
        self._changed = threading.Condition()
        self._waiting: deque[Entry] = deque()
        self._shown: deque[Entry] = deque()
        self._lasting: dict[str, Entry] = {}
        self._size = 0
        self.dropped = 0
        """Entries that no viewer has seen and none will see."""
        self.delivered = 0
        """Entries that were handed over, repetitions included."""
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="rerun live", daemon=True)
        self._thread.start()

    def put(self, item: Entry) -> None:
        """Keep an entry for the viewer; takes microseconds."""
        with self._changed:
            if item.is_static:
                self._lasting.pop(item.path, None)  # so that the latest stands last
                self._lasting[item.path] = item
            self._waiting.append(item)
            self._size += item.size
            self._make_room()
            self._changed.notify()

    def close(self, timeout_s: float = 2.0) -> None:
        """Hand over what waits, as far as the time allows; the rest counts as dropped."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            # The viewer takes nothing and its library waits for it, at the latest when this process ends.
            sever(self._port)
            self._thread.join(timeout_s)
        with self._changed:
            self.dropped += len(self._waiting)
            self._waiting.clear()
            self._shown.clear()

    def _make_room(self) -> None:
        while self._size > self._capacity and (self._shown or len(self._waiting) > 1):
            if self._shown:
                self._size -= self._shown.popleft().size
            else:
                self._size -= self._waiting.popleft().size
                self.dropped += 1

    def _work(self) -> None:
        while not self._is_over():
            line = _dial(self._port)
            if line is None:
                with self._changed:
                    self._changed.wait_for(lambda: self._closing, self._look_again_s)
                    if self._closing:
                        return
                continue
            with line:
                self._feed(line)

    def _feed(self, line: socket.socket) -> None:
        """Hand over entries until the viewer is gone or all are sent."""
        stream = new_stream(self._recording_id, low_latency=True)
        stream.connect_grpc(address(self._port))
        with self._changed:
            self._waiting.extendleft(reversed(self._shown))
            self._shown.clear()
            lasting = list(self._lasting.values())
        for item in lasting:
            item.write(stream)
        while not _is_gone(line):
            batch = self._take()
            if not batch:
                if self._is_over():
                    break
                continue
            for item in batch:
                item.write(stream)
            with self._changed:
                self.delivered += len(batch)
                self._shown.extend(batch)
        try:
            stream.flush(timeout_sec=5.0)
        except (RuntimeError, ValueError):
            return  # the viewer went away with the last entries; it is given them again should it come back
        stream.disconnect()

    def _take(self, most: int = 64) -> list[Entry]:
        """The next entries in line; none after a while without any."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting) or self._closing, self._look_again_s)
            return [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]

    def _is_over(self) -> bool:
        with self._changed:
            return self._closing and not self._waiting


def _dial(port: int) -> socket.socket | None:
    """A line to whoever listens on the port, held open to notice when that process goes."""
    try:
        line = socket.create_connection((HOST, port), timeout=1.0)
    except OSError:
        return None
    line.setblocking(False)
    return line


def sever(port: int) -> None:
    """Break this process's connections to a port of this machine, whoever holds them."""
    descriptors = Path("/dev/fd")
    for name in descriptors.iterdir() if descriptors.is_dir() else ():  # Windows has no such list
        try:
            copy = os.dup(int(name.name))
        except OSError:
            continue
        try:
            line = socket.socket(fileno=copy)
        except OSError:  # not a socket
            os.close(copy)
            continue
        with line, suppress(OSError):
            if line.family == socket.AF_INET and line.getpeername() == (HOST, port):
                line.shutdown(socket.SHUT_RDWR)


def _is_gone(line: socket.socket) -> bool:
    while True:
        try:
            if not line.recv(4096):
                return True
        except BlockingIOError:
            return False
        except OSError:
            return True


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def wait_for_viewer(port: int, timeout_s: float, gave_up: Callable[[], bool] = lambda: False) -> bool:
    """Whether somebody listens on the port within the time, and before `gave_up`."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and not gave_up():
        line = _dial(port)
        if line is not None:
            line.close()
            return True
        time.sleep(0.05)
    return False
