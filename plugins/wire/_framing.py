"""Frames on a serial line: ``[id, 2 bytes][payload][CRC-32]``, COBS, and a zero byte.

Consistent Overhead Byte Stuffing (Cheshire and Baker, IEEE/ACM Trans. Networking 7 (1999) 159,
doi:10.1109/90.769765) leaves no zero inside a frame, so that a decoder that lost its place finds
it again at the next zero. CRC-32 is that of IEEE 802.3 over identifier and payload, little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from zlib import crc32

from cobs import cobs

from plugins.wire._codec import Frame

MAX_PAYLOAD_BYTES = 4096
_MAX_CODED_BYTES = (2 + MAX_PAYLOAD_BYTES + 4) * 255 // 254 + 2
_IDENTIFIER, _CRC = struct.Struct("<H"), struct.Struct("<I")


def to_serial(frame: Frame) -> bytes:
    """The bytes of one frame, with its closing zero."""
    body = _IDENTIFIER.pack(frame.frame_id) + frame.payload
    coded: bytes = cobs.encode(body + _CRC.pack(crc32(body)))
    return coded + b"\0"


def all_to_serial(frames: Iterable[Frame]) -> bytes:
    """The bytes of several frames, concatenated."""
    return b"".join(map(to_serial, frames))


class SerialDecoder:
    """Decodes frames from chunks of bytes; damaged frames are dropped and counted.

    Memory is bounded: data longer than the longest frame without a zero are discarded.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._lost = False
        self.bad_frames = 0

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that these bytes complete, in order."""
        *coded, rest = (self._rest + data).split(b"\0")
        if coded and self._lost:
            del coded[0]
            self._lost = False
        if len(rest) > _MAX_CODED_BYTES:
            self.bad_frames += not self._lost
            rest, self._lost = b"", True
        self._rest = rest
        frames = []
        for piece in coded:
            if piece:
                frame = self._frame(piece)
                if frame is None:
                    self.bad_frames += 1
                else:
                    frames.append(frame)
        return frames

    def _frame(self, coded: bytes) -> Frame | None:
        try:
            body: bytes = cobs.decode(coded)
        except cobs.DecodeError:
            return None
        end = len(body) - 4
        if not 2 <= end <= 2 + MAX_PAYLOAD_BYTES or crc32(body[:end]) != _CRC.unpack_from(body, end)[0]:
            return None
        return Frame(_IDENTIFIER.unpack_from(body)[0], body[2:end])
