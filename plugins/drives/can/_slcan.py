"""A CAN bus by a serial adapter (Lawicel's ASCII format, `slcan`): sends and receives classic frames.

python-can's own `slcan` interface reads character by character and is slower than the bus.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from typing import ClassVar

from plugins.link import Line
from plugins.wire import CLASSIC_LAYOUT, BlockLayout, Frame, from_bus, on_bus
from protocols import InputError

SETTINGS = frozenset({"tty_baudrate", "sleep_after_open"})
"""Supported settings of python-can's interface."""
BIT_RATES = {
    10_000: 0,
    20_000: 1,
    50_000: 2,
    100_000: 3,
    125_000: 4,
    250_000: 5,
    500_000: 6,
    750_000: 7,
    1_000_000: 8,
}
_ANSWER_END = re.compile(rb"[\r\a]")
"""End of an answer: done (CR) or refused (BEL)."""
_MAX_ANSWER_CHARACTERS = 64
"""More than any answer has: noise that never ends one is not kept."""
_HEADER_CHARACTERS = 5
"""Characters before a frame's data: t, three of the identifier, one of the length."""


class SlcanPort:
    """An open bus.

    Parameters
    ----------
    channel : str
        The adapter's device, pseudo-terminal or ``socket://host:port``; ``@115200`` after it is its baud rate.
    bitrate : int
    bulk_rate : float
        Bytes of capture per second at this bit rate.
    node : int
        Node number of the drive; frames of others are ignored.
    settings : mapping
        `tty_baudrate`, and `sleep_after_open` [s] for adapters that opening resets, as in python-can.

    Raises pyserial's and the system's own errors, and `InputError` for settings that no adapter supports.
    """

    open_s: ClassVar[float] = 0.1
    """Time in which an adapter has to accept three short commands."""
    default_baud_rate: ClassVar[int] = 115_200
    sleep_after_open_s: ClassVar[float] = 2.0

    requests_each = 4
    blocks_each = 256

    def __init__(
        self,
        channel: str,
        bitrate: int,
        bulk_rate: float,
        *,
        node: int = 0,
        settings: Mapping[str, str | int | float | bool] | None = None,
    ) -> None:
        if bitrate not in BIT_RATES:
            known = ", ".join(map(str, BIT_RATES))
            raise InputError("the drive's bus", "bitrate", f"an adapter has {known}; got {bitrate}")
        options = settings or {}
        device, _, baud = channel.partition("@")
        baud_rate = _whole("tty_baudrate", baud or options.get("tty_baudrate", SlcanPort.default_baud_rate))
        self.where = f"slcan:{channel}" + (f" node {node}" if node else "")
        self._node, self._bulk_rate = node, bulk_rate
        self._line = Line(device, baud_rate)
        time.sleep(float(options.get("sleep_after_open", SlcanPort.sleep_after_open_s)))
        self._rest = b""
        self._before = b"\r"  # terminates an incomplete earlier command in the adapter
        self._line.write(b"\rC\rS%d\rO\r" % BIT_RATES[bitrate], SlcanPort.open_s)

    def layout(self, block_bytes: int) -> BlockLayout:
        return CLASSIC_LAYOUT

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        return self._bulk_rate

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        taken = self._line.write(self._before + self._encode(frames), timeout_s)
        self._before = b"" if taken else b"\r"
        return taken

    def fileno(self) -> int | None:
        return self._line.fileno()

    def as_written(self, frames: Sequence[Frame]) -> bytes:
        return b"\r" + self._encode(frames)  # terminates an incomplete frame of the other process

    def _encode(self, frames: Sequence[Frame]) -> bytes:
        lines = (f"t{on_bus(id_, self._node):03X}{len(data)}{data.hex().upper()}\r" for id_, data in frames)
        return "".join(lines).encode("ascii")

    def receive(self, timeout_s: float) -> list[Frame]:
        *answers, self._rest = _ANSWER_END.split(self._rest + self._line.read(timeout_s))
        self._rest = self._rest[-_MAX_ANSWER_CHARACTERS:]
        return [frame for answer in answers if (frame := self._frame(answer)) is not None]

    def _frame(self, answer: bytes) -> Frame | None:
        """Frame of this node in an answer; None for others and for damaged ones."""
        if answer[:1] != b"t" or len(answer) < _HEADER_CHARACTERS:
            return None
        try:
            identifier = from_bus(int(answer[1:4], 16), self._node)
            payload = bytes.fromhex(answer[_HEADER_CHARACTERS:].decode("ascii"))
            fits = len(payload) == int(answer[4:5])
        except ValueError:
            return None
        return Frame(identifier, payload) if fits and identifier is not None else None

    def close(self) -> None:
        try:
            self._line.write(b"\rC\r", SlcanPort.open_s)
        finally:
            self._line.close()


def _whole(name: str, value: str | float) -> int:
    try:
        return int(value)
    except ValueError:
        raise InputError("the drive's bus", f"settings.{name}", f"expected a whole number, got {value}") from None
