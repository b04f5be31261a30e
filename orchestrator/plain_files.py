"""Files that are read whole: plain ones, no larger than such files are. What is in them is not known here.

A pipe would be waited for for ever, and a device has no end. What is wrong is an `OSError`, as of any file that cannot
be read.
"""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class LargestFiles:
    """How large files may be that are read whole.

    Attributes
    ----------
    written_bytes : int
        By people: procedures, motors, mappings. To parse a megabyte of YAML takes ten seconds and 0.2 GB.
    kept_bytes : int
        By programs: manifests, journals, models, tables as text. A quarter of a million segments are less.
    """

    written_bytes: int = 4 << 20
    kept_bytes: int = 256 << 20


LARGEST = LargestFiles()


def read_bytes(path: Path, most: int = LARGEST.kept_bytes) -> bytes:
    """All of a plain file; raises `OSError` where it cannot be read, is something else, or is larger than `most`."""
    # A pipe that nobody writes to would not even be opened.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            problem = "is a directory" if stat.S_ISDIR(status.st_mode) else "is not a plain file"
            raise OSError(errno.EINVAL, problem, str(path))
        if status.st_size > most:
            raise OSError(errno.EFBIG, f"{1e-6 * status.st_size:.0f} MB are more than such a file has", str(path))
        with open(descriptor, "rb", closefd=False) as file:
            return file.read()
    finally:
        os.close(descriptor)


def read_text(path: Path, most: int = LARGEST.written_bytes, encoding: str = "utf-8") -> str:
    """All of a plain text file; raises `UnicodeDecodeError`, and what `read_bytes` raises."""
    return read_bytes(path, most).decode(encoding)
