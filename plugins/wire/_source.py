"""The device's end of an upload: a capture that grows, and answers to read requests. No I/O, no threads."""

from __future__ import annotations

from typing import NamedTuple
from zlib import crc32

from plugins.wire._blocks import BlockLayout
from plugins.wire._messages import AckStatus, BulkEnd, ReadBlock


class Answer(NamedTuple):
    """What goes out on a read request: block payloads, then the end."""

    payloads: list[bytes]
    end: BulkEnd


class CaptureSource:
    """One capture in the drive's memory.

    Parameters
    ----------
    number : int
        Capture number under which it is read.
    length : int
        Bytes that it will have when it is complete.
    memory_bytes : int, optional
        A ring: what is older than this many bytes has been overwritten. None: everything is kept.
    """

    def __init__(self, number: int, length: int, memory_bytes: int | None = None) -> None:
        self.number, self.length = number, length
        self._memory_bytes = memory_bytes
        self._data = bytearray()
        self._crc = 0

    @classmethod
    def complete_with(cls, number: int, data: bytes) -> CaptureSource:
        """A capture that is all there (a description, a table of ripple rows)."""
        source = cls(number, len(data))
        source.append(data)
        return source

    @property
    def captured(self) -> int:
        """Bytes so far."""
        return len(self._data)

    @property
    def complete(self) -> bool:
        return self.captured >= self.length

    def append(self, data: bytes) -> None:
        """Whole rows, as they are captured; what is past the announced length is left out."""
        data = data[: self.length - self.captured]
        self._crc = crc32(data, self._crc)
        self._data += data

    def answer(self, request: ReadBlock, layout: BlockLayout) -> Answer | AckStatus:
        """The blocks that are there, or why there are none.

        A block that is not full yet is left out until the capture is complete.
        """
        if request.capture != self.number:
            return AckStatus.NOT_CAPTURED
        if request.offset % layout.block or request.blocks > layout.most:
            return AckStatus.OUT_OF_RANGE
        if request.blocks and self._memory_bytes is not None and request.offset < self.captured - self._memory_bytes:
            return AckStatus.OVERWRITTEN
        there = self.captured - request.offset
        blocks = -(-there // layout.block) if self.complete else there // layout.block
        count = max(0, min(request.blocks, blocks))
        end = BulkEnd(self._crc, self.captured, request.window)
        with memoryview(self._data) as view:
            return Answer(layout.build(view, request.offset, count, request.window), end)
