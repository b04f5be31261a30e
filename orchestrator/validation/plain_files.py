"""Reading of plain files of limited size, whatever their content.

A pipe might never have data, and a device has no end; both raise `OSError`, like any unreadable file.
"""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path

from orchestrator.operating_system.files import BINARY, NON_BLOCKING


@dataclass(frozen=True)
class MaxFileSizes:
    """Limits of file sizes.

    Attributes
    ----------
    hand_written_bytes : int
        Files written by hand: procedures, motors, mappings. Parsing a megabyte of YAML takes ten seconds and 0.2 GB.
    generated_bytes : int
        Generated files: manifests, journals, models, tables as text. A quarter of a million segments need less.
    """

    hand_written_bytes: int = 4 << 20
    generated_bytes: int = 256 << 20


MAX_FILE_SIZES = MaxFileSizes()


def read_bytes(path: Path, max_bytes: int = MAX_FILE_SIZES.generated_bytes) -> bytes:
    """The content of a plain file; raises `OSError` for an unreadable, special or larger file."""
    # Opening a pipe without a writer would block.
    descriptor = os.open(path, os.O_RDONLY | NON_BLOCKING | BINARY)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            problem = "is a directory" if stat.S_ISDIR(status.st_mode) else "is not a plain file"
            raise OSError(errno.EINVAL, problem, str(path))
        if status.st_size > max_bytes:
            raise OSError(errno.EFBIG, f"{1e-6 * status.st_size:.0f} MB are too large for such a file", str(path))
        with open(descriptor, "rb", closefd=False) as file:
            return file.read()
    finally:
        os.close(descriptor)


def read_text(path: Path, max_bytes: int = MAX_FILE_SIZES.hand_written_bytes, encoding: str = "utf-8") -> str:
    """The content of a plain text file; raises `UnicodeDecodeError`, and the errors of `read_bytes`."""
    return read_bytes(path, max_bytes).decode(encoding)
