"""Inflated size of the variables of a version 5 .mat file, without keeping their content.

Each variable is compressed separately; a kilobyte may inflate to a megabyte (MathWorks, MAT-File Format, "Data
Element Format").
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

_HEADER, _TAG, _COMPRESSED = 128, struct.Struct("II"), 15
_PIECE = 1 << 20
"""Bytes to read or inflate at a time."""


def inflated_size(path: Path) -> int:
    """Inflated bytes of all variables; of a damaged file, those before the damage. Raises OSError."""
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
        pass  # the reader of the variable reports the damage
    return size
