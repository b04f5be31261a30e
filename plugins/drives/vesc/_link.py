"""A line to a VESC, serial or TCP: sends frames and sorts received ones by command."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict
from contextlib import suppress

from plugins.drives.vesc._packets import Decoder, encode_frame
from plugins.link import DriveLine, ProcessClock
from protocols import DriveFault

POLL_PERIOD_S = 0.05
WRITE_TIMEOUT_S = 1.0


class Link(DriveLine):
    """An open line with a reader thread, which `close` ends.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Baud rate of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        super().__init__("VESC", port, baud_rate, WRITE_TIMEOUT_S)
        self._queues: defaultdict[int, queue.SimpleQueue[bytes]] = defaultdict(queue.SimpleQueue)
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read, name="vesc", daemon=True)
        self._reader.start()

    def send(self, payload: bytes) -> None:
        """Write a frame; raises `DriveFault` where it cannot be sent."""
        self.write_bytes(encode_frame(payload))

    def take(self, command: int, timeout_s: float) -> bytes | None:
        """The next payload of a command; None after `timeout_s` without one, in which this process was running."""
        self.check()
        waited_s = ProcessClock()
        while True:
            remaining_s = timeout_s - waited_s()
            with suppress(queue.Empty):
                return self._queues[command].get(remaining_s > 0.0, min(max(remaining_s, 0.0), POLL_PERIOD_S))
            if remaining_s <= 0.0:
                return None

    def ask(self, payload: bytes, answer: int, timeout_s: float) -> bytes:
        """Send, and return the next payload of the command `answer`; raises `DriveFault` without one."""
        self.forget(answer)
        self.send(payload)
        payload_received = self.take(answer, timeout_s)
        if payload_received is None:
            raise self.lose(f"does not answer within {timeout_s:g} s")
        return payload_received

    def forget(self, command: int) -> None:
        """Drop the received payloads of a command."""
        self._queues[command] = queue.SimpleQueue()

    def close(self) -> None:
        """End the reader and close the line."""
        self._closed.set()
        self._reader.join()
        super().close()

    def _read(self) -> None:
        decoder = Decoder()
        with suppress(DriveFault):  # kept for the next use of the link
            while not self._closed.is_set() and self.lost is None:
                octets = self.read_bytes(POLL_PERIOD_S)
                for payload in decoder.feed(octets) if octets else decoder.pause():
                    self._queues[payload[0]].put(payload)
