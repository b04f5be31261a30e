"""The device's end of an upload: a growing capture, and answers to read requests. Pure logic."""

from __future__ import annotations

from typing import NamedTuple
from zlib import crc32

from plugins.wire._blocks import BlockLayout
from plugins.wire._messages import AckStatus, BulkEnd, ReadBlock


class Answer(NamedTuple):
    """Answer to a read request: block payloads, then the end."""

    payloads: list[bytes]
    end: BulkEnd


class CaptureSource:
    """A capture in the drive's memory.

    Parameters
    ----------
    number : int
        Capture number.
    length : int
        Bytes of the complete capture.
    memory_bytes : int, optional
        Size of a ring buffer that overwrites older bytes. None: everything is kept.
    """

    def __init__(self, number: int, length: int, memory_bytes: int | None = None) -> None:
        self.number, self.length = number, length
        self._memory_bytes = memory_bytes
        self._data = bytearray()
        self._crc = 0

    @classmethod
    def complete_with(cls, number: int, data: bytes) -> CaptureSource:
        """A complete capture (a description, a table of ripple rows)."""
        source = cls(number, len(data))
        source.append(data)
        return source

    @property
    def captured(self) -> int:
        """Bytes captured so far."""
        return len(self._data)

    @property
    def complete(self) -> bool:
        return self.captured >= self.length

    def append(self, data: bytes) -> None:
        """Append captured rows; data beyond the announced length are dropped."""
        data = data[: self.length - self.captured]
        self._crc = crc32(data, self._crc)
        self._data += data

    def answer(self, request: ReadBlock, layout: BlockLayout) -> Answer | AckStatus:
        """The requested blocks as far as captured, or the reason of a refusal.

        An incomplete block is omitted until the capture is complete.
        """
        if request.capture != self.number:
            return AckStatus.NOT_CAPTURED
        if request.offset % layout.block or request.blocks > layout.max_blocks:
            return AckStatus.OUT_OF_RANGE
        if request.blocks and self._memory_bytes is not None and request.offset < self.captured - self._memory_bytes:
            return AckStatus.OVERWRITTEN
        available = self.captured - request.offset
        blocks = -(-available // layout.block) if self.complete else available // layout.block
        count = max(0, min(request.blocks, blocks))
        end = BulkEnd(self._crc, self.captured, request.window)
        with memoryview(self._data) as view:
            return Answer(layout.build(view, request.offset, count, request.window), end)
