"""A byte line to a drive whose errors become `DriveFault`."""

from __future__ import annotations

import threading

from plugins.link._errors import PROBE_HINT
from plugins.link._line import Line
from protocols import DriveFault, FaultCause


class DriveLine:
    """An open line; its errors become `DriveFault` (link_lost), and the first one is kept.

    One thread reads; any may write.

    Parameters
    ----------
    name : str
        Name of the drive, for messages.
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Baud rate of a UART.
    write_timeout_s : float
        Time without a successful write after which the line is lost.
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
        """Write; raises `DriveFault` where the line does not accept the data."""
        self.check()
        try:
            with self._writing:
                taken = self._line.write(data, self._write_timeout_s)
        except OSError as error:
            raise self.lose(error.strerror or str(error)) from None
        if not taken:
            raise self.lose(f"accepts no data for {self._write_timeout_s:g} s")

    def read_bytes(self, wait_s: float) -> bytes:
        """Received bytes, waiting for the first one only; raises `DriveFault` where the line is lost."""
        try:
            return self._line.read(wait_s)
        except OSError as error:
            raise self.lose(error.strerror or str(error)) from None

    def check(self) -> None:
        """Raise `DriveFault` where the line is lost."""
        if self.lost is not None:
            raise self.lost

    def lose(self, why: str) -> DriveFault:
        """Mark the line as lost; returns the first reason, to be raised."""
        self.lost = self.lost or DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        return self.lost

    def close(self) -> None:
        """Close the line."""
        self._line.close()
