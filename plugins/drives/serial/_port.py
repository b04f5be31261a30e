"""A serial line with COBS frames: sends and receives frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from plugins.link import Line
from plugins.wire import BlockLayout, Frame, SerialDecoder, all_to_serial, serial_blocks


class SerialPort:
    """An open serial line; parameters and errors as those of `Line`."""

    frame_overhead_bytes: ClassVar[int] = 16
    """Overhead of a block: identifier, offset, CRC-32, stuffing and the closing zero."""
    block_load_ratio: ClassVar[float] = 0.9
    """Share of the line for blocks, beside telemetry, requests and repetitions."""

    requests_each = 16
    blocks_each = 64

    def __init__(self, port: str, baud_rate: int, *, dtr: bool = True) -> None:
        self.where = port
        self._line = Line(port, baud_rate, dtr=dtr)
        self._line_rate = baud_rate / 10.0 if self._line.is_device else None
        self._decoder = SerialDecoder()
        self._before = b"\0"  # terminates an incomplete earlier frame at the receiver

    @property
    def bad_frames(self) -> int:
        """Number of damaged frames, which were dropped."""
        return self._decoder.bad_frames

    def layout(self, block_bytes: int) -> BlockLayout:
        return serial_blocks(block_bytes)

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        if self._line_rate is None:
            return None
        return (
            SerialPort.block_load_ratio
            * self._line_rate
            * layout.block
            / (layout.block + SerialPort.frame_overhead_bytes)
        )

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        taken = self._line.write(self._before + all_to_serial(frames), timeout_s)
        self._before = b"" if taken else b"\0"  # the receiver drops a truncated frame as damaged
        return taken

    def fileno(self) -> int | None:
        return self._line.fileno()

    def as_written(self, frames: Sequence[Frame]) -> bytes:
        return b"\0" + all_to_serial(frames)  # terminates an incomplete frame of the other process

    def receive(self, timeout_s: float) -> list[Frame]:
        return self._decoder.feed(self._line.read(timeout_s))

    def close(self) -> None:
        self._line.close()
