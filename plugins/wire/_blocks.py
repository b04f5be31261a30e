"""Bulk data as blocks: layout of a capture on each link, processed in batches of frames."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plugins.wire._codec import frame_id
from protocols import InputError

Bytes = NDArray[np.uint8]
Numbers = NDArray[np.int64]

DESCRIPTION_CAPTURE = 0xFFFF
"""Capture number of the drive's description."""
RIPPLE_FLAG = 0x8000
"""Flag in a capture number that selects its ripple rows."""
LAST_CAPTURE = DESCRIPTION_CAPTURE - RIPPLE_FLAG - 1
"""The highest capture number; 1 follows it."""
WINDOW_COUNT = 64
MAX_CAPTURE_BYTES = (1 << 26) - 1
"""Largest number of addressable bytes of a capture."""


class Blocks(NamedTuple):
    """A batch of received blocks: tag of the request, position and data of each."""

    window: Numbers
    position: Numbers
    """Block number, counted within the answer (classic CAN) or within the capture."""
    data: Bytes


@dataclass(frozen=True)
class BlockLayout:
    """Layout of a block on a link."""

    name: str
    block: int
    """Data bytes of a block."""
    header: int
    relative: bool
    """Whether blocks are counted from the request's offset instead of the capture's start."""
    max_blocks: int
    """Largest number of blocks in a request."""

    @property
    def frame_id(self) -> int:
        """Identifier of the bulk frames."""
        return frame_id(self.name)

    def parse(self, payloads: Sequence[bytes]) -> Blocks:
        """Parse payloads in one batch; those of a wrong length are dropped."""
        size = self.header + self.block
        joined = b"".join(payloads)
        if len(joined) != size * len(payloads) or any(len(payload) != size for payload in payloads):
            joined = b"".join(payload for payload in payloads if len(payload) == size)
        table = np.frombuffer(joined, dtype=np.uint8).reshape(-1, size)
        head = np.ascontiguousarray(table[:, : self.header]).view(f"<u{self.header}")[:, 0].astype(np.int64)
        if self.relative:
            return Blocks(head >> 10, head & 0x3FF, table[:, self.header :])
        offset = head & MAX_CAPTURE_BYTES
        return Blocks(head >> 26, np.where(offset % self.block == 0, offset // self.block, -1), table[:, self.header :])

    def build(self, capture: memoryview, offset: int, count: int, window: int) -> list[bytes]:
        """Payloads of `count` blocks from `offset` on; zeros past the end of `capture`."""
        data: Any = capture[offset : offset + count * self.block]
        if len(data) < count * self.block:
            data = bytes(data) + bytes(count * self.block - len(data))
        if self.relative:
            heads = (struct.pack("<H", index | window << 10) for index in range(count))
        else:
            heads = (struct.pack("<I", (offset + k * self.block) | window << 26) for k in range(count))
        return [head + data[k * self.block : (k + 1) * self.block] for k, head in enumerate(heads)]


CLASSIC_LAYOUT = BlockLayout("Bulk", block=6, header=2, relative=True, max_blocks=1024)
"""Layout on classic CAN."""
CAN_FD_LAYOUT = BlockLayout("BulkFD", block=60, header=4, relative=False, max_blocks=65535)
"""Layout on CAN FD."""


def serial_blocks(block_bytes: int) -> BlockLayout:
    """Layout on a serial line, with the block length of the drive's register bulk_block_bytes.

    Raises `InputError` where the length is not between 60 and 4080.
    """
    if not 60 <= block_bytes <= 4080:
        raise InputError("wire", "bulk_block_bytes", f"expected 60 to 4080, got {block_bytes}")
    return BlockLayout("BulkFD", block=block_bytes, header=4, relative=False, max_blocks=65535)
