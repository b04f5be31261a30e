"""Locks on files that end with their process, however that ends: ``flock``, or ``locking`` on Windows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from orchestrator.operating_system.files import BINARY

LOCK_NAME = ".lock"
"""Name of the file that is locked for a folder."""
LOCKED_BYTE = 1 << 30
"""Place that is locked on Windows, where a locked byte cannot be read: beyond any content."""


@contextmanager
def locked_file(file: Path) -> Iterator[int]:
    """The descriptor of a file, created where missing, and locked for this process while the block lasts.

    Raises
    ------
    BlockingIOError
        Where another process holds the lock.
    OSError
        Where the file cannot be opened.
    """
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT | BINARY, 0o644)
    try:
        if not _lock(descriptor):
            raise BlockingIOError("locked by another process")
        yield descriptor
    finally:
        os.close(descriptor)


def is_locked(file: Path) -> bool:
    """Whether a process holds the lock of a file; not of one that is missing or cannot be opened."""
    try:
        descriptor = os.open(file, os.O_RDONLY | BINARY)
    except OSError:
        return False
    try:
        return not _lock(descriptor, shared=True)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, *, shared: bool = False) -> bool:
    """Whether this process has the lock now; Windows has no shared ones."""
    try:
        import fcntl
    except ImportError:
        return _lock_byte(descriptor)
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _lock_byte(descriptor: int) -> bool:
    from importlib import import_module

    msvcrt = import_module("msvcrt")  # by name: type checkers know it on Windows alone
    os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError:
        return False
    finally:
        os.lseek(descriptor, 0, os.SEEK_SET)
    return True
