"""A line to a VESC, serial or TCP: sends frames, sorts what comes by its command. Knows no command's meaning."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict
from contextlib import suppress

from plugins.drives.vesc._packets import Decoder, framed
from plugins.link import DriveLine
from protocols import DriveFault

POLL_PERIOD_S = 0.05
WRITE_TIMEOUT_S = 1.0


class Link(DriveLine):
    """An open line; its reader is a thread that `close` ends.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        super().__init__("VESC", port, baud_rate, WRITE_TIMEOUT_S)
        self._come: defaultdict[int, queue.SimpleQueue[bytes]] = defaultdict(queue.SimpleQueue)
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read, name="vesc", daemon=True)
        self._reader.start()

    def send(self, payload: bytes) -> None:
        """Write a frame; raises `DriveFault` where it does not go out."""
        self.write_bytes(framed(payload))

    def take(self, command: int, timeout_s: float) -> bytes | None:
        """The next payload of a command; None where none comes in time."""
        self.check()
        try:
            return self._come[command].get(timeout=timeout_s) if timeout_s > 0 else self._come[command].get_nowait()
        except queue.Empty:
            return None

    def ask(self, payload: bytes, answer: int, timeout_s: float) -> bytes:
        """Send, and take the next answer of this command; raises `DriveFault` where there is none."""
        self.forget(answer)
        self.send(payload)
        answered = self.take(answer, timeout_s)
        if answered is None:
            raise self.lose(f"does not answer within {timeout_s:g} s")
        return answered

    def forget(self, command: int) -> None:
        """Drop what has come of this command."""
        self._come[command] = queue.SimpleQueue()

    def close(self) -> None:
        """End the reader and let go of the line."""
        self._closed.set()
        self._reader.join()
        super().close()

    def _read(self) -> None:
        decoder = Decoder()
        with suppress(DriveFault):  # kept for whoever uses the link next
            while not self._closed.is_set() and self.lost is None:
                for payload in decoder.feed(self.read_bytes(POLL_PERIOD_S)):
                    self._come[payload[0]].put(payload)
