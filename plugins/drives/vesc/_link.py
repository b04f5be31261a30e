"""A line to a VESC, serial or TCP: sends frames, sorts what comes by its command. Knows no command's meaning."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict

from plugins.drives.vesc._packets import Decoder, framed
from plugins.link import Line
from protocols import DriveFault, FaultCause

POLL_PERIOD_S = 0.05
WRITE_TIMEOUT_S = 1.0


class Link:
    """An open line; its reader is a thread that `close` ends. Errors become `DriveFault` (link_lost), and stay.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self.where = f"VESC at {port}"
        self.lost: DriveFault | None = None
        try:
            self._line = Line(port, baud_rate)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {error.strerror or error}") from None
        self._come: defaultdict[int, queue.SimpleQueue[bytes]] = defaultdict(queue.SimpleQueue)
        self._writing, self._closed = threading.Lock(), threading.Event()
        self._reader = threading.Thread(target=self._read, name="vesc", daemon=True)
        self._reader.start()

    def send(self, payload: bytes) -> None:
        """Write a frame; raises `DriveFault` where it does not go out."""
        self.check()
        try:
            with self._writing:
                taken = self._line.write(framed(payload), WRITE_TIMEOUT_S)
        except OSError as error:
            raise self._lose(error.strerror or str(error)) from None
        if not taken:
            raise self._lose(f"takes nothing for {WRITE_TIMEOUT_S:g} s")

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
            raise self._lose(f"does not answer within {timeout_s:g} s")
        return answered

    def forget(self, command: int) -> None:
        """Drop what has come of this command."""
        self._come[command] = queue.SimpleQueue()

    def check(self) -> None:
        """Raises `DriveFault` where the line is lost."""
        if self.lost is not None:
            raise self.lost

    def close(self) -> None:
        """End the reader and let go of the line."""
        self._closed.set()
        self._reader.join()
        self._line.close()

    def _lose(self, why: str) -> DriveFault:
        self.lost = self.lost or DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        return self.lost

    def _read(self) -> None:
        decoder = Decoder()
        while not self._closed.is_set() and self.lost is None:
            try:
                octets = self._line.read(POLL_PERIOD_S)
            except OSError as error:
                self._lose(error.strerror or str(error))
                return
            for payload in decoder.feed(octets):
                self._come[payload[0]].put(payload)
