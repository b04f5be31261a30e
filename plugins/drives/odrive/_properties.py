"""ODrive's ASCII protocol (communication/ascii_protocol.cpp): lines to read and write properties. Knows no motor."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence

from plugins.link import Line
from protocols import DriveFault, FaultCause

ANSWER_TIMEOUT_S = 0.5
WRITE_TIMEOUT_S = 0.5


class Properties:
    """A board's properties behind a line; errors become `DriveFault` (link_lost), and stay.

    Properties are read and written by one thread; any may send a line that has no answer.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self.where = f"ODrive at {port}"
        self.lost: DriveFault | None = None
        try:
            self._line = Line(port, baud_rate)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {error.strerror or error}") from None
        self._writing, self._come = threading.Lock(), b""

    def send(self, line: str) -> None:
        """Write one line; raises `DriveFault` where it does not go out."""
        self._send(f"{line}\n".encode())

    def read(self, names: Sequence[str]) -> list[float]:
        """Properties, read in one request; raises `DriveFault` where one is no number."""
        self._forget()
        self._send("".join(f"r {name}\n" for name in names).encode())
        return [self._number(name, self._next()) for name in names]

    def write(self, values: Mapping[str, float]) -> None:
        """Set properties one after the other, and read them back; raises `DriveFault` where one is not held."""
        for name, value in values.items():
            self.send(f"w {name} {_shown(value)}")
        for (name, value), held in zip(values.items(), self.read(list(values)), strict=True):
            if abs(held - value) > 1e-4 * abs(value) + 1e-4:
                raise DriveFault(FaultCause.WRONG_DATA, f"{self.where}: {name} is {held:g} after {value:g} was written")

    def check(self) -> None:
        """Raises `DriveFault` where the line is lost."""
        if self.lost is not None:
            raise self.lost

    def close(self) -> None:
        """Let go of it."""
        self._line.close()

    def _number(self, name: str, answer: str) -> float:
        try:
            return float(answer)
        except ValueError:
            message = f"{self.where}: {name} is {answer!r}, expected a number"
            raise DriveFault(FaultCause.WRONG_DATA, message) from None

    def _send(self, data: bytes) -> None:
        self.check()
        try:
            with self._writing:
                taken = self._line.write(data, WRITE_TIMEOUT_S)
        except OSError as error:
            raise self._lose(error.strerror or str(error)) from None
        if not taken:
            raise self._lose(f"takes nothing for {WRITE_TIMEOUT_S:g} s")

    def _next(self) -> str:
        deadline = time.monotonic() + ANSWER_TIMEOUT_S
        while b"\n" not in self._come:
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                raise self._lose(f"does not answer within {ANSWER_TIMEOUT_S:g} s")
            self._receive(left_s)
        answer, _, self._come = self._come.partition(b"\n")
        return answer.strip().decode("latin1")

    def _receive(self, wait_s: float) -> None:
        try:
            self._come += self._line.read(wait_s)
        except OSError as error:
            raise self._lose(error.strerror or str(error)) from None

    def _forget(self) -> None:
        self.check()
        self._receive(0.0)
        self._come = b""

    def _lose(self, why: str) -> DriveFault:
        self.lost = self.lost or DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        return self.lost


def _shown(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.7f}"
