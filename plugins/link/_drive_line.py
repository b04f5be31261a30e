"""A line to one drive whose errors become `DriveFault`. No frames."""

from __future__ import annotations

import threading

from plugins.link._errors import PROBE_HINT
from plugins.link._line import Line
from protocols import DriveFault, FaultCause


class DriveLine:
    """An open line; its errors become `DriveFault` (link_lost), and the first one stays.

    One thread reads; any may write.

    Parameters
    ----------
    name : str
        Of the drive, for messages.
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    write_timeout_s : float
        A line that takes nothing for so long is lost.
    """

    def __init__(self, name: str, port: str, baud_rate: int, write_timeout_s: float) -> None:
        self.where = f"{name} at {port}"
        self.lost: DriveFault | None = None
        self._write_timeout_s, self._writing = write_timeout_s, threading.Lock()
        try:
            self._line = Line(port, baud_rate)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {error.strerror or error}{PROBE_HINT}") from None

    def write_bytes(self, data: bytes) -> None:
        """Write; raises `DriveFault` where it does not go out."""
        self.check()
        try:
            with self._writing:
                taken = self._line.write(data, self._write_timeout_s)
        except OSError as error:
            raise self.lose(error.strerror or str(error)) from None
        if not taken:
            raise self.lose(f"takes nothing for {self._write_timeout_s:g} s")

    def read_bytes(self, wait_s: float) -> bytes:
        """What is there, waiting for the first byte only; raises `DriveFault` where the line is lost."""
        try:
            return self._line.read(wait_s)
        except OSError as error:
            raise self.lose(error.strerror or str(error)) from None

    def check(self) -> None:
        """Raise `DriveFault` where the line is lost."""
        if self.lost is not None:
            raise self.lost

    def lose(self, why: str) -> DriveFault:
        """Give the line up; returns the first reason, to be raised."""
        self.lost = self.lost or DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        return self.lost

    def close(self) -> None:
        """Let go of it."""
        self._line.close()
