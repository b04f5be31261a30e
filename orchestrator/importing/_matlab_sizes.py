"""How large the variables of a .mat file of version 5 are once they are inflated; nothing of them is kept.

They are compressed one by one, and a kilobyte of a file may become a megabyte (MathWorks, MAT-File Format, "Data
Element Format").
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_HEADER, _TAG, _COMPRESSED = 128, struct.Struct("II"), 15
_PIECE = 1 << 20
"""Bytes that are read, or inflated, at a time."""


def inflated_size(path: Path) -> int:
    """Bytes of all variables; of a damaged file those before the damage. Raises OSError."""
    size = 0
    with path.open("rb") as file:
        order = ">" if file.read(_HEADER)[-2:] == b"MI" else "<"
        while len(tag := file.read(_TAG.size)) == _TAG.size:
            kind, length = struct.unpack(f"{order}II", tag)
            end = file.tell() + length
            size += _inflated(file, length) if kind == _COMPRESSED else length
            file.seek(end)
    return size


def _inflated(file: BinaryIO, length: int) -> int:
    inflating, size = zlib.decompressobj(), 0
    try:
        while length > 0 and (piece := file.read(min(_PIECE, length))):
            length -= len(piece)
            while piece:
                size += len(inflating.decompress(piece, _PIECE))
                piece = inflating.unconsumed_tail
    except zlib.error:
        pass  # who reads the variable says so
    return size
