"""ODrive's ASCII protocol (communication/ascii_protocol.cpp): lines that read and write properties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from plugins.link import DriveLine, ProcessClock
from protocols import DriveFault, FaultCause

ANSWER_TIMEOUT_S = 0.5
"""Time of this process without an answer, after which the line is lost."""
POLL_PERIOD_S = 0.05
WRITE_TIMEOUT_S = 0.5


class Properties(DriveLine):
    """A board's properties by a line. One thread reads and writes them; any thread may send a line without an answer.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Baud rate of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        super().__init__("ODrive", port, baud_rate, WRITE_TIMEOUT_S)
        self._received = b""

    def send(self, line: str) -> None:
        """Write one line; raises `DriveFault` where it cannot be sent."""
        self.write_bytes(f"{line}\n".encode())

    def read(self, names: Sequence[str]) -> list[float]:
        """Properties, read in one request; raises `DriveFault` where one is not a number."""
        self.check()
        self.read_bytes(0.0)  # a late answer to an earlier request
        self._received = b""
        self.write_bytes("".join(f"r {name}\n" for name in names).encode())
        return [self._number(name, self._next()) for name in names]

    def write(self, values: Mapping[str, float]) -> None:
        """Set properties in order and read them back; raises `DriveFault` where one differs."""
        for name, value in values.items():
            self.send(f"w {name} {_formatted(value)}")
        for (name, value), now in zip(values.items(), self.read(list(values)), strict=True):
            if abs(now - value) > 1e-4 * abs(value) + 1e-4:
                raise DriveFault(FaultCause.WRONG_DATA, f"{self.where}: {name} is {now:g} after {value:g} was written")

    def _number(self, name: str, answer: str) -> float:
        try:
            return float(answer)
        except ValueError:
            message = f"{self.where}: {name} is {answer!r}, expected a number"
            raise DriveFault(FaultCause.WRONG_DATA, message) from None

    def _next(self) -> str:
        waited_s = ProcessClock()
        while b"\n" not in self._received:
            if waited_s() > ANSWER_TIMEOUT_S:
                raise self.lose(f"does not answer within {ANSWER_TIMEOUT_S:g} s")
            self._received += self.read_bytes(POLL_PERIOD_S)
        answer, _, self._received = self._received.partition(b"\n")
        return answer.strip().decode("latin1")


def _formatted(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.7f}"
