"""ODrive's ASCII protocol (communication/ascii_protocol.cpp): lines to read and write properties. Knows no motor."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from plugins.link import DriveLine
from protocols import DriveFault, FaultCause

ANSWER_TIMEOUT_S = 0.5
WRITE_TIMEOUT_S = 0.5


class Properties(DriveLine):
    """A board's properties behind a line. They are read and written by one thread; any may send a line without answer.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        super().__init__("ODrive", port, baud_rate, WRITE_TIMEOUT_S)
        self._come = b""

    def send(self, line: str) -> None:
        """Write one line; raises `DriveFault` where it does not go out."""
        self.write_bytes(f"{line}\n".encode())

    def read(self, names: Sequence[str]) -> list[float]:
        """Properties, read in one request; raises `DriveFault` where one is no number."""
        self.check()
        self.read_bytes(0.0)  # a late answer to an earlier request
        self._come = b""
        self.write_bytes("".join(f"r {name}\n" for name in names).encode())
        return [self._number(name, self._next()) for name in names]

    def write(self, values: Mapping[str, float]) -> None:
        """Set properties one after the other, and read them back; raises `DriveFault` where one is not held."""
        for name, value in values.items():
            self.send(f"w {name} {_shown(value)}")
        for (name, value), held in zip(values.items(), self.read(list(values)), strict=True):
            if abs(held - value) > 1e-4 * abs(value) + 1e-4:
                raise DriveFault(FaultCause.WRONG_DATA, f"{self.where}: {name} is {held:g} after {value:g} was written")

    def _number(self, name: str, answer: str) -> float:
        try:
            return float(answer)
        except ValueError:
            message = f"{self.where}: {name} is {answer!r}, expected a number"
            raise DriveFault(FaultCause.WRONG_DATA, message) from None

    def _next(self) -> str:
        deadline = time.monotonic() + ANSWER_TIMEOUT_S
        while b"\n" not in self._come:
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                raise self.lose(f"does not answer within {ANSWER_TIMEOUT_S:g} s")
            self._come += self.read_bytes(left_s)
        answer, _, self._come = self._come.partition(b"\n")
        return answer.strip().decode("latin1")


def _shown(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.7f}"
